//! Parallel loops whose machinery is compiled once, and not for every closure: rayon's was an eighth of this
//! crate's machine code.

use std::cell::Cell;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

thread_local! {
    /// Whether loops of this thread stay on it.
    static ALONE: Cell<bool> = const { Cell::new(false) };
}

/// `f`, whose loops stay on this thread: it takes no other work until it is done.
pub(crate) fn alone<T>(f: impl FnOnce() -> T) -> T {
    let before = ALONE.replace(true);
    let value = f();
    ALONE.set(before);
    value
}

/// `f(0)` to `f(n - 1)` on all threads, in order.
pub(crate) fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let places: Vec<Mutex<Option<T>>> = (0..n).map(|_| Mutex::new(None)).collect();
    each(n, &|i| {
        let value = f(i);
        *places[i].lock().unwrap_or_else(PoisonError::into_inner) = Some(value);
    });
    let value = |place: Mutex<Option<T>>| {
        let value = place.into_inner();
        value.unwrap_or_else(PoisonError::into_inner)
    };
    places.into_iter().filter_map(value).collect()
}

/// `f` of whole ranges of `0..n`, of so many numbers each, on all threads, in order.
pub(crate) fn ranges<T: Send>(
    n: usize,
    each: usize,
    f: impl Fn(Range<usize>) -> T + Sync,
) -> Vec<T> {
    map(n.div_ceil(each), |i| f(i * each..((i + 1) * each).min(n)))
}

/// The same as [`map`] of what is made in no time, written where it stays.
pub(crate) fn fill<T: Send>(n: usize, f: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    if ALONE.get() {
        return (0..n).map(f).collect();
    }
    (0..n).into_par_iter().map(f).collect()
}

/// Sorts, on all threads.
pub(crate) fn sort(numbers: &mut [(u64, u64)]) {
    if ALONE.get() {
        numbers.sort_unstable();
    } else {
        numbers.par_sort_unstable();
    }
}

/// Both, each on a thread of its own if one is free.
pub(crate) fn both<A: Send, B: Send>(
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    if ALONE.get() {
        (a(), b())
    } else {
        rayon::join(a, b)
    }
}

/// `f` of every item and its number, on all threads.
pub(crate) fn over<T: Send>(items: impl Iterator<Item = T>, f: impl Fn(usize, T) + Sync) {
    let items: Vec<_> = items.map(|item| Mutex::new(Some(item))).collect();
    each(items.len(), &|i| {
        let item = items[i]
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(item) = item {
            f(i, item);
        }
    });
}

fn each(n: usize, f: &(dyn Fn(usize) + Sync)) {
    if ALONE.get() {
        (0..n).for_each(f);
    } else {
        (0..n).into_par_iter().for_each(f);
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn values_are_in_order() {
        assert_eq!(
            super::map(1000, |i| 3 * i),
            (0..1000).map(|i| 3 * i).collect::<Vec<_>>()
        );
        assert!(super::map(0, |_| ()).is_empty());
        let parts = super::ranges(10, 4, |range| range);
        assert_eq!(parts, [0..4, 4..8, 8..10]);
        assert_eq!(super::fill(1000, &|i| 3 * i), super::map(1000, |i| 3 * i));
    }

    #[test]
    fn one_thread_does_the_same() {
        let sorted = || {
            let mut numbers: Vec<_> = (0..5000u64).map(|i| (i * 7919 % 5003, i)).collect();
            super::sort(&mut numbers);
            (
                numbers,
                super::fill(5000, &|i| 3 * i),
                super::map(50, |i| i * i),
                super::both(|| 1, || 2),
            )
        };
        let here = std::thread::current().id();
        let elsewhere = |_| std::thread::current().id() != here;
        let stays = || super::map(100, elsewhere).iter().all(|e| !e);
        assert!(super::alone(|| stays() && super::alone(stays) && stays()));
        assert_eq!(super::alone(sorted), sorted());
    }

    #[test]
    fn every_item_is_met() {
        let mut values = vec![1; 100];
        super::over(values.chunks_mut(30), |i, part| {
            part.iter_mut().for_each(|v| *v += i)
        });
        assert_eq!(
            [values[0], values[29], values[30], values[99]],
            [1, 1, 2, 4]
        );
    }
}
