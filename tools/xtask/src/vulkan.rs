//! Detects a Vulkan loader, drivers and the validation layer from the file system alone.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What this machine has.
#[derive(Debug, Default)]
pub struct Detected {
    /// The loader, `libvulkan`.
    pub loader: bool,
    /// Manifest of the software driver, lavapipe.
    pub software: Option<PathBuf>,
    /// Manifests of other drivers whose library exists, where a graphics device node exists too.
    pub hardware: Vec<PathBuf>,
    /// The Khronos validation layer.
    pub validation: bool,
}

impl Detected {
    /// Whether the loader would find a usable driver.
    pub fn driver(&self) -> bool {
        self.software.is_some() || !self.hardware.is_empty()
    }
}

/// Inspects this machine.
pub fn detect() -> Detected {
    let libraries = libraries();
    let (software, hardware): (Vec<_>, Vec<_>) = drivers()
        .into_iter()
        .filter(|m| fs::read_to_string(m).is_ok_and(|text| usable(&text, m, &libraries)))
        .partition(|m| is_lavapipe(m));
    Detected {
        loader: has_loader(&libraries),
        software: software.into_iter().next(),
        hardware: if has_device_node() { hardware } else { Vec::new() },
        validation: layers().iter().any(|l| l.is_file()),
    }
}

/// What the dynamic linker knows, as `ldconfig` prints it; empty where there is none.
fn libraries() -> String {
    let ask = |p: &str| Command::new(p).arg("-p").output().ok().filter(|o| o.status.success());
    let out = ask("ldconfig").or_else(|| ask("/sbin/ldconfig"));
    out.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default()
}

fn has_loader(libraries: &str) -> bool {
    let name = match env::consts::OS {
        "macos" => "libvulkan.1.dylib",
        "windows" => "vulkan-1.dll",
        _ => "libvulkan.so.1",
    };
    has_library(name, libraries)
}

/// Whether the linker would find a library of this bare name.
fn has_library(name: &str, libraries: &str) -> bool {
    let listed = libraries.lines().any(|l| l.split_whitespace().next() == Some(name));
    let from_env = ["LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"].map(env::var_os);
    let given = from_env.iter().flatten().flat_map(env::split_paths);
    let usual =
        ["/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/lib", "C:\\Windows\\System32"];
    listed || given.chain(usual.map(PathBuf::from)).any(|dir| dir.join(name).is_file())
}

/// Driver manifests in the order the loader looks; a variable that names them replaces the search.
fn drivers() -> Vec<PathBuf> {
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        if let Some(list) = env::var_os(variable).filter(|v| !v.is_empty()) {
            return env::split_paths(&list).flat_map(manifest_or_folder).collect();
        }
    }
    let more = env::var_os("VK_ADD_DRIVER_FILES").unwrap_or_default();
    let added = env::split_paths(&more).flat_map(manifest_or_folder).collect::<Vec<_>>();
    added.into_iter().chain(folders("vulkan/icd.d").iter().flat_map(|d| manifests(d))).collect()
}

fn layers() -> Vec<PathBuf> {
    let file = "VkLayer_khronos_validation.json";
    let given = env::var_os("VK_LAYER_PATH").unwrap_or_default();
    let given = env::split_paths(&given).collect::<Vec<_>>();
    given.into_iter().chain(folders("vulkan/explicit_layer.d")).map(|d| d.join(file)).collect()
}

/// Where the loader looks for `below`: configuration, then data, then the user's own.
fn folders(below: &str) -> Vec<PathBuf> {
    let list = |variable: &str, default: &str| {
        let value = env::var_os(variable).filter(|v| !v.is_empty());
        env::split_paths(&value.unwrap_or_else(|| default.into())).collect::<Vec<_>>()
    };
    let mut all = list("XDG_CONFIG_DIRS", "/etc/xdg");
    all.extend(["/etc", "/usr/local/etc"].map(PathBuf::from));
    all.extend(list("XDG_DATA_DIRS", "/usr/local/share:/usr/share"));
    all.push("/usr/share".into());
    all.push("/run/opengl-driver/share".into());
    all.extend(env::home_dir().map(|home| home.join(".local/share")));
    all.iter().map(|d| d.join(below)).collect()
}

fn manifest_or_folder(path: PathBuf) -> Vec<PathBuf> {
    if path.is_dir() { manifests(&path) } else { vec![path] }
}

fn manifests(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<_> = entries.map(|e| e.path()).filter(|p| is_json(p)).collect();
    found.sort();
    found
}

fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "json")
}

fn is_lavapipe(manifest: &Path) -> bool {
    manifest.file_name().is_some_and(|n| n.to_string_lossy().starts_with("lvp_icd"))
}

/// Whether the library that a manifest names exists. A bare name is the linker's to find, a
/// relative path starts at the manifest.
fn usable(text: &str, manifest: &Path, libraries: &str) -> bool {
    let Some(after) = text.split("\"library_path\"").nth(1) else { return false };
    let Some(path) = after.split('"').nth(1) else { return false };
    if path.contains('/') || path.contains('\\') {
        manifest.parent().is_some_and(|folder| folder.join(path).is_file())
    } else {
        has_library(path, libraries)
    }
}

/// Whether the system shows a graphics device: Mesa's hardware drivers are often installed where
/// there is none.
fn has_device_node() -> bool {
    if !cfg!(target_os = "linux") {
        return true;
    }
    let render = fs::read_dir("/dev/dri").into_iter().flatten().flatten();
    let mut render = render.map(|e| e.file_name().to_string_lossy().into_owned());
    render.any(|n| n.starts_with("renderD"))
        || ["/dev/nvidiactl", "/dev/dxg"].iter().any(|p| Path::new(p).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CACHE: &str =
        "2 libs found\n\tlibvulkan_lvp.so (libc6,x86-64) => /lib/libvulkan_lvp.so\n";

    #[test]
    fn a_driver_manifest_counts_only_if_its_library_exists() {
        let at = Path::new("/nowhere/lvp_icd.json");
        let manifest = |path: &str| format!("{{ \"ICD\": {{ \"library_path\": \"{path}\" }} }}");
        assert!(usable(&manifest("libvulkan_lvp.so"), at, CACHE));
        assert!(!usable(&manifest("libvulkan_gone.so"), at, CACHE));
        assert!(!usable(&manifest("/no/such/libvulkan_lvp.so"), at, CACHE));
        assert!(!usable("{}", at, CACHE));
    }

    #[test]
    fn libraries_are_matched_by_whole_name() {
        assert!(has_library("libvulkan_lvp.so", CACHE));
        assert!(!has_library("libvulkan_l", CACHE));
    }
}
