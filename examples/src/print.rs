//! What tools and figures print. Nothing printed is worth more than the files that a run leaves: what cannot be printed
//! stops nothing, and is accounted for at the end ([`finish`]).

use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};
use std::sync::{Mutex, PoisonError};

/// The first thing that went wrong on standard output; nothing more is printed then.
static FAILED: Mutex<Option<io::Error>> = Mutex::new(None);

/// A text for standard output.
pub fn out(text: Arguments) {
    let mut failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner);
    if failed.is_none() {
        *failed = io::stdout().lock().write_fmt(text).err();
    }
}

/// A text for standard error. Where that goes nowhere, there is nobody left to tell.
pub fn err(text: Arguments) {
    let _ = io::stderr().lock().write_fmt(text);
}

/// Whether all that was printed has arrived. Who closes a pipe has read enough: that counts as arrived.
///
/// # Errors
/// The operating system's: a full disk, say.
pub fn finish() -> io::Result<()> {
    let failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner).take();
    wanted(failed.map_or_else(|| io::stdout().flush(), Err))
}

/// What a printing attempt says about its reader.
pub(crate) fn wanted(printed: io::Result<()>) -> io::Result<()> {
    printed.or_else(|e| match e.kind() {
        ErrorKind::BrokenPipe => Ok(()),
        _ => Err(e),
    })
}

/// Prints a line on standard output, as `println!`, but does not panic where that is not possible.
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => {
        $crate::print::out(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// Prints a line on standard error, as `eprintln!`, but does not panic where that is not possible.
#[macro_export]
macro_rules! complain {
    ($($text:tt)*) => {
        $crate::print::err(format_args!("{}\n", format_args!($($text)*)))
    };
}
