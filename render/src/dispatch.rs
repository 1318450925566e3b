//! How the lists of materials, shapes and emitters call their members.
//!
//! The members marked `inline` are compiled into the path tracer's loop; everything else is
//! called. With all of them inlined the loop would spill to memory in every scene; with none, the
//! commonest ones would pass their interactions through memory and wait for it, in diffuse scenes above all.

/// Runs `f` as a call of its own.
#[inline(never)]
pub(crate) fn outline<T>(f: impl FnOnce() -> T) -> T {
    f()
}

/// The closures take their arguments by value, so that those of the inlined members stay in registers.
///
/// One `match` over an enum of models: `dispatch!(self, [Inline, ..] [Other, ..], m => m.call())`.
macro_rules! dispatch {
    ($self:ident, [$($inline:ident),*] [$($name:ident),*], $m:ident => $call:expr) => {
        match $self {
            $(Self::$inline($m) => $call,)*
            $(Self::$name($m) => $crate::dispatch::outline(move || $call),)*
        }
    };
}
pub(crate) use dispatch;
