//! Work that takes long: without the lock of the interpreter, on threads of its own, until it is done or somebody wants it
//! to stop.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use render::integrator::render::Progress;

use crate::error::Error;

/// How often signals are looked at and progress is reported.
const PERIOD: Duration = Duration::from_millis(50);

/// How far work is, and whether it is wanted.
#[derive(Debug, Default)]
struct Watch {
    done: AtomicU64,
    cancelled: AtomicBool,
}

impl Progress for Watch {
    fn advance(&self, n: u64) {
        self.done.fetch_add(n, Ordering::Relaxed);
    }
    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// Runs `f` without the lock of the interpreter. `progress` is called with the part that is done, from 0 to 1, of `total`
/// units of work.
///
/// # Errors
/// Those of `f`; `KeyboardInterrupt` after Ctrl-C, or whatever `progress` raises: `f` is then cancelled, and its result is
/// lost; `RuntimeError` in a process that was forked from one that has rendered, whose threads are not there, and where
/// `f` panics.
pub fn work<T: Send>(
    py: Python<'_>,
    total: u64,
    progress: Option<&Py<PyAny>>,
    f: impl FnOnce(&dyn Progress) -> Result<T, Error> + Send,
) -> PyResult<T> {
    refuse_forks()?;
    let watch = Watch::default();
    let report = |py: Python<'_>, part: f64| match progress {
        Some(progress) => progress.call1(py, (part,)).map(|_| ()),
        None => Ok(()),
    };
    let (done, stopped) = py.detach(|| {
        thread::scope(|scope| {
            let (end, ended) = channel::<()>();
            let watch = &watch;
            let worker = scope.spawn(move || {
                // Hung up when it is dropped, be it by a panic.
                let _end = end;
                f(watch)
            });
            let mut stopped = None;
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(PERIOD) {
                if stopped.is_some() {
                    continue;
                }
                let part = watch.done.load(Ordering::Relaxed) as f64 / total.max(1) as f64;
                let asked = Python::attach(|py| {
                    py.check_signals()?;
                    report(py, part.min(1.0))
                });
                if let Err(e) = asked {
                    watch.cancelled.store(true, Ordering::Relaxed);
                    stopped = Some(e);
                }
            }
            (worker.join(), stopped)
        })
    });
    if let Some(e) = stopped {
        return Err(e);
    }
    let done = done.map_err(|panic| PyRuntimeError::new_err(said(panic.as_ref())))??;
    report(py, 1.0)?;
    Ok(done)
}

/// [`work`] that asks nobody whether it is wanted, such as reading files: after Ctrl-C it goes on by itself to its end, and its
/// result is lost.
///
/// # Errors
/// As there.
pub fn apart<T: Send + 'static>(
    py: Python<'_>,
    f: impl FnOnce() -> Result<T, Error> + Send + 'static,
) -> PyResult<T> {
    refuse_forks()?;
    let (end, ended) = channel();
    thread::spawn(move || {
        // Nobody may be there any more.
        let _ = end.send(catch_unwind(AssertUnwindSafe(f)));
    });
    let done = py.detach(move || {
        loop {
            match ended.recv_timeout(PERIOD) {
                Ok(done) => break PyResult::Ok(done),
                Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
                Err(RecvTimeoutError::Disconnected) => {
                    break Err(PyRuntimeError::new_err(
                        "a thread has ended without a result",
                    ));
                }
            }
        }
    })?;
    Ok(done.map_err(|panic| PyRuntimeError::new_err(said(panic.as_ref())))??)
}

/// Threads are not there in a process that was forked from one that has started some.
fn refuse_forks() -> PyResult<()> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    if *FIRST.get_or_init(process::id) == process::id() {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(
        "this process was forked from one that has rendered, and its threads are not here; expected one that was \
         started by `spawn`",
    ))
}

/// What a panic said.
fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!(
        "a fault of the renderer, which should be reported: {}",
        text.unwrap_or("a panic")
    )
}
