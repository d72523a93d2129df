//! Long version text: `intima --version`.

use std::sync::LazyLock;

/// Commit of the build; empty in a development build, which may hold changes of no commit.
const COMMIT: &str = env!("INTIMA_COMMIT");

/// Optional features, and whether they were built in.
const FEATURES: [(&str, bool); 2] =
    [("window", cfg!(feature = "window")), ("jpeg-12", cfg!(feature = "jpeg-12"))];

/// Version, commit, features and target, a line each.
pub fn long() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let commit = if COMMIT.is_empty() { "none (development build)" } else { COMMIT };
        let built: Vec<&str> = FEATURES.iter().filter(|f| f.1).map(|f| f.0).collect();
        let features = if built.is_empty() { "none".to_owned() } else { built.join(", ") };
        let (arch, os) = (std::env::consts::ARCH, std::env::consts::OS);
        let version = env!("CARGO_PKG_VERSION");
        format!("{version}\ncommit: {commit}\nfeatures: {features}\ntarget: {arch}-{os}")
    });
    &TEXT
}
