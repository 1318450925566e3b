//! Progress bars, and Ctrl-C as a request instead of an end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressStyle};
use render::integrator::render::Progress;

use crate::complain;

/// Exit code of a tool that was stopped by Ctrl-C and kept what was complete.
pub const INTERRUPTED: u8 = 130;

/// Whether the user wants to stop. Clones share the answer.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<State>);

#[derive(Debug, Default)]
struct State {
    asked: AtomicBool,
    /// Whether there is anything to keep.
    keeps: AtomicBool,
}

impl Interrupt {
    /// Set by Ctrl-C (and by the signals that ask a process to end). It ends the process at once if it is the second one,
    /// or while there is nothing to keep yet ([`Interrupt::keep`]).
    pub fn on_signal() -> Self {
        let interrupt = Self::default();
        let flag = interrupt.clone();
        let handler = move || {
            let again = flag.0.asked.swap(true, Ordering::Relaxed);
            let keeps = flag.0.keeps.load(Ordering::Relaxed);
            if !keeps {
                complain!("interrupted before the work began: nothing was written");
            }
            if again || !keeps {
                std::process::exit(INTERRUPTED.into());
            }
        };
        // Without a handler Ctrl-C ends the program as usual, which is no reason not to start.
        if let Err(e) = ctrlc::set_handler(handler) {
            complain!("warning: Ctrl-C will not keep partial results: {e}");
        }
        interrupt
    }

    /// From here on there may be something to keep, and whoever works asks [`Interrupt::is_set`] many times a second.
    pub fn keep(&self) {
        self.0.keeps.store(true, Ordering::Relaxed);
    }

    /// Asks to stop.
    pub fn set(&self) {
        self.0.asked.store(true, Ordering::Relaxed);
    }

    /// Whether to stop.
    pub fn is_set(&self) -> bool {
        self.0.asked.load(Ordering::Relaxed)
    }
}

/// A progress bar on the terminal, if there is one; it stops what it watches when interrupted.
#[derive(Debug)]
pub struct Bar {
    bar: ProgressBar,
    interrupt: Interrupt,
}

impl Bar {
    /// A bar of `total` units, preceded by `what`.
    pub fn new(what: &str, total: u64, interrupt: &Interrupt) -> Self {
        let bar = ProgressBar::new(total);
        let template = "{prefix} [{elapsed}] {wide_bar} {percent}% {msg} [{eta} left]";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_prefix(what.to_owned());
        Self {
            bar,
            interrupt: interrupt.clone(),
        }
    }

    /// Shows `text` behind the bar.
    pub fn message(&self, text: String) {
        self.bar.set_message(text);
    }

    /// Moves the bar to `position`.
    pub fn set(&self, position: u64) {
        self.bar.set_position(position);
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for Bar {
    fn advance(&self, n: u64) {
        self.bar.inc(n);
    }
    fn cancelled(&self) -> bool {
        self.interrupt.is_set()
    }
}

/// No bar: stops when interrupted, that is all.
impl Progress for Interrupt {
    fn cancelled(&self) -> bool {
        self.is_set()
    }
}
