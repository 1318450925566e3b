//! Searches among few places, where nobody can predict which one it is.

use std::hint::select_unpredictable;

/// Half of the places from the first to the last one that may be the first that is not `before`, without branches; both
/// once it is known.
#[inline(always)]
pub(crate) fn halve([first, last]: [usize; 2], before: impl Fn(usize) -> bool) -> [usize; 2] {
    let middle = (first + last) / 2;
    let (open, passed) = (first < last, before(middle));
    [
        select_unpredictable(open & passed, middle + 1, first),
        select_unpredictable(open & !passed, middle, last),
    ]
}

/// The first of these places that is not `before`, or the last of them.
#[inline(always)]
pub(crate) fn first_not(range: [usize; 2], before: impl Fn(usize) -> bool) -> usize {
    // Mostly there are up to three of them, which takes two steps.
    let [mut first, mut last] = halve(halve(range, &before), &before);
    while first < last {
        let middle = (first + last) / 2;
        if before(middle) {
            first = middle + 1
        } else {
            last = middle
        }
    }
    first
}
