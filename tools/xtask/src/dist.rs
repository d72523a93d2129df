//! `cargo xtask dist`: what a release consists of, in `out/dist/`.
//!
//! A folder with the program, its manual pages, completions and licences; the same as an archive
//! and as a Debian package; a recipe for a container about the package; and the sums of all. The
//! same commit gives the same archive and package, byte for byte, where the compiler does.

use crate::TaskError;
use crate::process::{cargo, command, output, root, run};
use std::fs;
use std::path::{Path, PathBuf};

const OUT: &str = "out/dist";
const RECIPE: &str = "tools/dist/Containerfile";
/// Shells, and where their completions stand below `/usr/share` in Debian.
const SHELLS: [(&str, &str); 3] = [
    ("bash", "bash-completion/completions/intima"),
    ("zsh", "zsh/vendor-completions/_intima"),
    ("fish", "fish/vendor_completions.d/intima.fish"),
];
const DOCUMENTS: [&str; 4] = ["README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"];

/// A release under construction.
struct Release {
    version: String,
    /// Commit, with `-dirty` where files differ from it.
    commit: String,
    /// Time of the commit, seconds since 1970: the time of every file.
    time: String,
}

/// `cargo xtask dist [--dirty]`
pub fn dist(args: &[&str]) -> Result<(), TaskError> {
    let dirty = match args {
        [] => false,
        ["--dirty"] => true,
        other => return Err(TaskError::Usage(format!("dist: no such flag: {}", other.join(" ")))),
    };
    let release = Release::of_commit(dirty)?;
    run(cargo(&[
        "build",
        "--release",
        "--locked",
        "--package",
        "intima",
        "--features",
        "jpeg-12",
    ])
    .env("INTIMA_COMMIT", &release.commit)
    .env("RUSTFLAGS", flags_without_paths()))?;
    let out = root().join(OUT);
    clear(&out)?;
    let tree = release.tree(&out)?;
    let glibc = newest_glibc(&tree.join("usr/bin/intima"))?;
    eprintln!("The program needs glibc {glibc} or newer.");
    let files = [release.archive(&tree)?, release.debian_package(&tree, &glibc)?];
    copy(&root().join(RECIPE), &out.join("Containerfile"))?;
    fs::remove_dir_all(&tree).map_err(failed(&tree))?;
    let sums =
        output(command("sha256sum", &files.each_ref().map(String::as_str)).current_dir(&out))?;
    write(&out.join("SHA256SUMS"), &sums)?;
    print!("{sums}");
    Ok(())
}

/// Compiler flags by which no path of the building machine gets into the program: those of messages
/// and panics begin with `~` or `intima`.
fn flags_without_paths() -> String {
    let given = std::env::var("RUSTFLAGS").unwrap_or_default();
    // The last prefix that fits is taken: the project may lie in the home folder.
    let home = std::env::home_dir().map(|home| (home, "~"));
    let folders = home.into_iter().chain([(root(), "intima")]);
    folders.fold(given, |flags, (folder, name)| {
        format!("{flags} --remap-path-prefix={}={name}", folder.display())
    })
}

impl Release {
    fn of_commit(dirty_allowed: bool) -> Result<Self, TaskError> {
        let git = |args: &[&str]| output(&mut command("git", args)).map(|s| s.trim().to_owned());
        let changed = !git(&["status", "--porcelain"])?.is_empty();
        if changed && !dirty_allowed {
            let hint = "files differ from the commit: commit them, or name the build so by --dirty";
            return Err(TaskError::Failed(hint.to_owned()));
        }
        let mut commit = git(&["rev-parse", "HEAD"])?;
        commit += if changed { "-dirty" } else { "" };
        let manifest = read(&root().join("Cargo.toml"))?;
        Ok(Self {
            version: version(&manifest)?.to_owned(),
            commit,
            time: git(&["log", "-1", "--format=%ct"])?,
        })
    }

    /// Lays the files out as they are installed; returns the folder.
    fn tree(&self, out: &Path) -> Result<PathBuf, TaskError> {
        let tree = out.join("tree");
        let at = |path: &str| tree.join("usr").join(path);
        let program = at("bin/intima");
        let built = std::env::var_os("CARGO_TARGET_DIR")
            .map_or_else(|| root().join("target"), PathBuf::from);
        copy(&built.join("release/intima"), &program)?;
        run(&mut command("strip", &["--strip-debug", text(&program)?]))?;
        for (shell, path) in SHELLS {
            let script = output(&mut command(text(&program)?, &["completions", shell]))?;
            write(&at("share").join(path), &script)?;
        }
        let manual = at("share/man/man1");
        fs::create_dir_all(&manual).map_err(failed(&manual))?;
        run(&mut command(text(&program)?, &["man", "--out", text(&manual)?]))?;
        for page in files_in(&manual)? {
            run(&mut command("gzip", &["-9", "--no-name", text(&page)?]))?;
        }
        for name in DOCUMENTS {
            copy(&root().join(name), &at("share/doc/intima").join(name))?;
        }
        Ok(tree)
    }

    /// Writes the archive; returns its name.
    fn archive(&self, tree: &Path) -> Result<String, TaskError> {
        let folder = format!("intima-{}-{}-linux", self.version, std::env::consts::ARCH);
        let name = format!("{folder}.tar.gz");
        run(&mut command(
            "tar",
            &[
                "--create",
                "--gzip",
                "--sort=name",
                "--owner=0",
                "--group=0",
                "--numeric-owner",
                &format!("--mtime=@{}", self.time),
                &format!("--transform=s,^usr,{folder},"),
                &format!("--directory={}", text(tree)?),
                &format!("--file={}", text(&root().join(OUT).join(&name))?),
                "usr",
            ],
        ))?;
        Ok(name)
    }

    /// Writes the Debian package; returns its name.
    fn debian_package(&self, tree: &Path, glibc: &str) -> Result<String, TaskError> {
        let arch = output(&mut command("dpkg", &["--print-architecture"]))?.trim().to_owned();
        let name = format!("intima_{}_{arch}.deb", self.version);
        let copyright = tree.join("usr/share/doc/intima/copyright");
        write(&copyright, "intima is licensed under MIT or Apache-2.0; see LICENSE-* here.\n")?;
        let control = control(&self.version, &arch, glibc);
        write(&tree.join("DEBIAN/control"), &control)?;
        let mut build = command("dpkg-deb", &["--root-owner-group", "--build", text(tree)?, &name]);
        // All times of the package are the commit's.
        run(build.current_dir(root().join(OUT)).env("SOURCE_DATE_EPOCH", &self.time))?;
        Ok(name)
    }
}

/// Control file. The Vulkan loader is opened at run time, and so are the libraries of the display:
/// without them the program computes on the CPU.
fn control(version: &str, arch: &str, glibc: &str) -> String {
    format!(
        "Package: intima
Version: {version}
Architecture: {arch}
Maintainer: The intima developers <intima@localhost>
Section: science
Priority: optional
Depends: libc6 (>= {glibc}), libgcc-s1
Recommends: libvulkan1, mesa-vulkan-drivers, ffmpeg
Suggests: libxkbcommon0, libxkbcommon-x11-0, libx11-xcb1, libxcursor1, libxi6
Description: Virtual endoscopy on Vulkan compute
 Takes a CT or MR volume and flies through a hollow organ inside it: colon,
 airway, artery. Research and education only; not a medical device.
"
    )
}

/// The package's version in a manifest.
fn version(manifest: &str) -> Result<&str, TaskError> {
    let line = manifest.lines().find_map(|l| l.strip_prefix("version = \""));
    let missing = || TaskError::Failed("Cargo.toml: no version".to_owned());
    line.and_then(|l| l.strip_suffix('"')).ok_or_else(missing)
}

/// Newest version of the C library that a program asks for.
fn newest_glibc(program: &Path) -> Result<String, TaskError> {
    let symbols = output(&mut command("objdump", &["-T", text(program)?]))?;
    let newest = newest_version(&symbols);
    newest.ok_or_else(|| TaskError::Failed(format!("{}: no symbol of glibc", program.display())))
}

fn newest_version(symbols: &str) -> Option<String> {
    let versions = symbols.split("GLIBC_").skip(1).filter_map(|rest| {
        let end = rest.find(|c: char| c != '.' && !c.is_ascii_digit()).unwrap_or(rest.len());
        let parts: Option<Vec<u32>> = rest[..end].split('.').map(|n| n.parse().ok()).collect();
        parts.filter(|p| p.len() > 1)
    });
    versions.max().map(|v| v.iter().map(u32::to_string).collect::<Vec<_>>().join("."))
}

fn clear(folder: &Path) -> Result<(), TaskError> {
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(failed(folder))?;
    }
    fs::create_dir_all(folder).map_err(failed(folder))
}

fn copy(from: &Path, to: &Path) -> Result<(), TaskError> {
    make_parent(to)?;
    fs::copy(from, to).map(drop).map_err(failed(from))
}

fn write(path: &Path, content: &str) -> Result<(), TaskError> {
    make_parent(path)?;
    fs::write(path, content).map_err(failed(path))
}

fn read(path: &Path) -> Result<String, TaskError> {
    fs::read_to_string(path).map_err(failed(path))
}

fn make_parent(path: &Path) -> Result<(), TaskError> {
    let parent = path.parent().expect("a file stands in a folder");
    fs::create_dir_all(parent).map_err(failed(parent))
}

fn files_in(folder: &Path) -> Result<Vec<PathBuf>, TaskError> {
    let entries = fs::read_dir(folder).map_err(failed(folder))?;
    let paths = entries.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>();
    paths.map_err(failed(folder))
}

fn failed(path: &Path) -> impl Fn(std::io::Error) -> TaskError {
    move |e| TaskError::Failed(format!("{}: {e}", path.display()))
}

fn text(path: &Path) -> Result<&str, TaskError> {
    let not_unicode = || TaskError::Failed(format!("{}: not Unicode", path.display()));
    path.to_str().ok_or_else(not_unicode)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_glibc_is_found_by_number_and_not_by_letters() {
        let symbols = "(GLIBC_2.9)  read\n(GLIBC_2.34)  pthread_create\n(GLIBC_2.2.5)  memcpy\n";
        assert_eq!(newest_version(symbols).as_deref(), Some("2.34"));
        assert_eq!(newest_version("GLIBC_PRIVATE x"), None);
    }

    #[test]
    fn the_version_is_the_package_s() {
        assert!(version(&read(&root().join("Cargo.toml")).unwrap()).unwrap().starts_with("0."));
        assert!(version("[workspace]").is_err());
    }

    #[test]
    fn the_control_file_has_what_debian_requires() {
        let control = control("0.2.0", "amd64", "2.34");
        for field in ["Package: ", "Version: 0.2.0\n", "Architecture: amd64\n", "Maintainer: "] {
            assert!(control.contains(field), "{field}");
        }
        assert!(control.contains("libc6 (>= 2.34)") && control.ends_with('\n'));
    }
}
