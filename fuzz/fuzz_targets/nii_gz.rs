//! Compressed NIfTI.
#![no_main]

#[path = "../file.rs"]
mod file;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| file::read("a.nii.gz", bytes));
