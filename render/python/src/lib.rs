//! The renderer as a module of Python: `render_gradients`, whose native half this is.
//!
//! Scenes are loaded, rendered and differentiated over arrays of numpy. What is computed, and what is refused, is that of
//! the crates [`render`] and [`optim`], with their messages; nothing is computed here. Work runs without the lock of the
//! interpreter, and Ctrl-C ends it (`work`). What is convenient and needs no speed is written in Python, beside this
//! (`python/render_gradients`), and so are the stubs that editors read, which a test compares with what is here.

mod arrays;
mod check;
mod error;
mod estimators;
mod images;
mod instructions;
mod loss;
mod optimizer;
mod scene;
mod work;

/// The native half of `render_gradients`.
#[pyo3::pymodule]
mod _native {
    /// The instructions that this module may use beyond those that every machine of its architecture has, by the names
    /// of the compiler: wheels for everybody have only a few.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const target_features: &str = env!("TARGET_FEATURES");
    #[pymodule_export]
    use crate::check::Check;
    #[pymodule_export]
    use crate::estimators::{EstimatorInfo, estimators};
    #[pymodule_export]
    use crate::images::{read_image, write_image};
    #[pymodule_export]
    use crate::instructions::has_x86_64_v3;
    #[pymodule_export]
    use crate::loss::{loss, z_limit};
    #[pymodule_export]
    use crate::optimizer::Optimizer;
    #[pymodule_export]
    use crate::scene::{Scene, load, load_string, room};
}
