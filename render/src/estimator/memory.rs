//! Whether paths remember something, as a type: what a strategy does not need takes no room in its paths.

use std::fmt::Debug;

/// [`Keep`] or [`Forget`].
pub trait Memory: Send + Sync + 'static {
    /// Whether it is [`Keep`].
    const KEEPS: bool;
    /// Room for a `T`, or none.
    type Of<T: Copy + Debug>: Store<T>;
    /// [`Keep`] if either is.
    type Or<M: Memory>: Memory;
}

/// Room for at most one `T`.
pub trait Store<T>: Copy + Debug + Default {
    /// Replaces what is kept.
    fn put(&mut self, value: Option<T>);
    /// What is kept.
    fn get(&self) -> Option<T>;
}

/// What is to be kept is kept.
#[derive(Clone, Copy, Debug)]
pub struct Keep;

/// What is to be kept is dropped, and takes no room.
#[derive(Clone, Copy, Debug)]
pub struct Forget;

impl Memory for Keep {
    const KEEPS: bool = true;
    type Of<T: Copy + Debug> = Option<T>;
    type Or<M: Memory> = Self;
}

impl Memory for Forget {
    const KEEPS: bool = false;
    type Of<T: Copy + Debug> = ();
    type Or<M: Memory> = M;
}

impl<T: Copy + Debug> Store<T> for Option<T> {
    #[inline(always)]
    fn put(&mut self, value: Option<T>) {
        *self = value;
    }
    #[inline(always)]
    fn get(&self) -> Option<T> {
        *self
    }
}

impl<T> Store<T> for () {
    #[inline(always)]
    fn put(&mut self, _value: Option<T>) {}
    #[inline(always)]
    fn get(&self) -> Option<T> {
        None
    }
}
