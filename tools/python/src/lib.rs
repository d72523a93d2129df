//! The native module `intima._intima`: sessions of the engine for Python.
//!
//! It is the thin part. Arrays come in borrowed ([`array`]) and go out as the memory that they were
//! computed in, settings come as a dictionary ([`settings`]), and work runs on a thread of its own
//! so that Ctrl-C is heard ([`call`]). What users see (functions, data classes, their documentation)
//! is Python, in `python/intima`.

mod array;
mod call;
mod error;
mod frames;
mod mesh;
mod session;
mod settings;

/// Sessions of the engine, and what needs none.
#[pyo3::pymodule]
mod _intima {
    #[pymodule_export]
    use super::frames::Frames;
    #[pymodule_export]
    use super::mesh::simplify;
    #[pymodule_export]
    use super::session::Session;
    #[pymodule_export]
    use super::session::read;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
