//! Asking for memory before it is needed.

/// Brings the line of the cache that `x` begins in near, and does not wait for it. A read whose result is not needed would
/// do nearly the same, but nothing that comes after it is finished before it.
#[inline(always)]
pub(crate) fn prefetch<T>(x: &T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint, which has no effect but on time, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(x).cast()) }
    }
    // Elsewhere stable Rust has no such instruction.
    #[cfg(not(target_arch = "x86_64"))]
    let _ = x;
}
