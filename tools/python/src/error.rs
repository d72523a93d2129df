//! Errors of the engine as exceptions of `intima`, with the engine's own texts.

use intima::session::SessionError;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// An exception of `intima._errors` by its name. They are Python's, because a class of the stable
/// interface cannot have two bases.
fn exception(name: &str, text: String) -> PyErr {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    Python::attach(|py| {
        let import = || py.import("intima._errors").map(Bound::unbind);
        let module = MODULE.get_or_try_init(py, import)?.bind(py);
        let class = module.getattr(name)?.cast_into::<PyType>().map_err(PyErr::from)?;
        Ok(PyErr::from_type(class, text))
    })
    .unwrap_or_else(|e| e)
}

/// An argument that makes no sense.
pub fn argument(text: String) -> PyErr {
    exception("ArgumentError", text)
}

/// An input that is not what the function needs.
pub fn input(text: String) -> PyErr {
    exception("InputError", text)
}

/// Anything else.
pub fn failure(text: String) -> PyErr {
    exception("Error", text)
}

/// An error of a session, by the classes in which the command line has its exit codes.
pub fn session(error: SessionError) -> PyErr {
    use SessionError as S;
    let class = match &error {
        S::LumenNotChosen { .. } | S::Unavailable { .. } | S::Setting(_) => "ArgumentError",
        S::Format(e) if e.is_bad_input() => "InputError",
        S::Lumen(_) | S::Organ(_) | S::Centerline(_) | S::Mesh(_) | S::Maps(_) => "InputError",
        S::Flight(_) | S::CameraPath(_) | S::ShearedGrid { .. } | S::Enclosed { .. } => {
            "InputError"
        }
        S::Device(e) if e.is_no_device() => "DeviceError",
        S::Render(e) if e.is_no_device() => "DeviceError",
        S::Memory { .. } => "MemoryLimitError",
        S::Cancelled => "Cancelled",
        _ => "Error",
    };
    exception(class, error.to_string())
}

/// A thread that the system did not give.
pub fn no_thread(error: &std::io::Error) -> PyErr {
    PyRuntimeError::new_err(format!("no thread: {error}"))
}
