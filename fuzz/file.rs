//! One input as a file: readers take paths.

use std::cell::RefCell;

#[path = "../tests/common/src/readers.rs"]
mod readers;

thread_local! {
    static FOLDER: RefCell<Option<tempfile::TempDir>> = const { RefCell::new(None) };
}

/// Reads `bytes` as a file of this name. Whether it is read or refused does not matter; a panic,
/// an error of more than a line, or memory beyond the fuzzer's limit is a fault.
pub fn read(name: &str, bytes: &[u8]) {
    FOLDER.with_borrow_mut(|folder| {
        let folder = folder.get_or_insert_with(|| tempfile::tempdir().expect("a folder"));
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file");
        if let Err(e) = readers::read(&path, bytes) {
            assert!(!e.contains('\n'), "more than a line: {e}");
        }
    });
}
