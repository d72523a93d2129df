//! Installs what is missing through the system's package manager, and nothing that is there.

use crate::run::{command, loudly, on_path, quietly};
use crate::{Stop, vulkan};

/// What the machine is wanted for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum For {
    /// Running intima: a loader and a driver.
    Running,
    /// Testing it: also the validation layer and the SPIR-V tools it needs to see through our shaders.
    Testing,
}

/// A thing that may be missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    Loader,
    Driver,
    Validation,
    SpirvTools,
}

/// A package manager: program, how it installs, how it refreshes its lists, its names for things.
struct Manager {
    program: &'static str,
    install: &'static [&'static str],
    refresh: &'static [&'static str],
    names: fn(Need) -> &'static str,
}

const MANAGERS: &[Manager] = &[
    Manager {
        program: "apt-get",
        install: &["install", "-y", "--no-install-recommends"],
        refresh: &["update"],
        names: |need| match need {
            Need::Loader => "libvulkan1",
            Need::Driver => "mesa-vulkan-drivers",
            Need::Validation => "vulkan-validationlayers",
            Need::SpirvTools => "spirv-tools",
        },
    },
    Manager {
        program: "dnf",
        install: &["install", "-y"],
        refresh: &["makecache"],
        names: |need| match need {
            Need::Loader => "vulkan-loader",
            Need::Driver => "mesa-vulkan-drivers",
            Need::Validation => "vulkan-validation-layers",
            Need::SpirvTools => "spirv-tools",
        },
    },
    Manager {
        program: "pacman",
        install: &["-S", "--noconfirm", "--needed"],
        refresh: &["-Sy"],
        names: |need| match need {
            Need::Loader => "vulkan-icd-loader",
            Need::Driver => "vulkan-swrast",
            Need::Validation => "vulkan-validation-layers",
            Need::SpirvTools => "spirv-tools",
        },
    },
];

/// Makes the machine ready, or says exactly what to install.
pub fn setup(what_for: For) -> Result<(), Stop> {
    let needs = missing(&vulkan::look(), on_path("spirv-opt"), what_for);
    if needs.is_empty() {
        return Ok(());
    }
    eprintln!("missing: {needs:?}");
    let manager = MANAGERS.iter().find(|m| on_path(m.program));
    let (Some(manager), Some(prefix)) = (manager, rights()) else {
        return Err(Stop::NoDevice(advice(&needs)));
    };
    install(manager, prefix, &needs).map_err(|_| Stop::NoDevice(advice(&needs)))?;
    let still = missing(&vulkan::look(), on_path("spirv-opt"), what_for);
    if still.is_empty() { Ok(()) } else { Err(Stop::NoDevice(advice(&still))) }
}

fn missing(found: &vulkan::Found, spirv_opt: bool, what_for: For) -> Vec<Need> {
    let testing = what_for == For::Testing;
    let all = [
        (Need::Loader, found.loader),
        (Need::Driver, found.driver()),
        (Need::Validation, found.validation || !testing),
        (Need::SpirvTools, spirv_opt || !testing),
    ];
    all.into_iter().filter(|(_, there)| !there).map(|(need, _)| need).collect()
}

/// What to put before a package manager's name: nothing as root, `sudo -n` where that asks for no
/// password, else no rights at all.
fn rights() -> Option<&'static [&'static str]> {
    let root = command("id", &["-u"]).output().is_ok_and(|o| o.stdout.trim_ascii() == b"0");
    if root {
        Some(&[])
    } else {
        quietly(&mut command("sudo", &["-n", "true"])).then_some(&["sudo", "-n"])
    }
}

/// Installs at once; if that fails, the lists may be old or absent: refreshes them and tries again.
fn install(manager: &Manager, prefix: &[&str], needs: &[Need]) -> Result<(), Stop> {
    let names: Vec<_> = needs.iter().map(|n| (manager.names)(*n)).collect();
    let with = |args: &[&str]| {
        // `env`, because sudo drops variables: no package may stop to ask.
        let start = ["env", "DEBIAN_FRONTEND=noninteractive", manager.program];
        let words = [prefix, &start, args].concat();
        loudly(&mut command(words[0], &words[1..]))
    };
    let install = [manager.install, &names].concat();
    with(&install).or_else(|_| {
        with(manager.refresh)?;
        with(&install)
    })
}

/// What a person should type, for every package manager we know.
fn advice(needs: &[Need]) -> String {
    let lines = MANAGERS.iter().map(|m| {
        let names: Vec<_> = needs.iter().map(|n| (m.names)(*n)).collect();
        format!("  sudo {} {} {}\n", m.program, m.install.join(" "), names.join(" "))
    });
    let intro = "Vulkan is not complete here and could not be installed; one of these does it:\n";
    let rest = "Elsewhere: the Vulkan SDK from https://vulkan.lunarg.com, or your GPU's driver.";
    intro.to_owned() + &lines.collect::<String>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vulkan::Found;
    use std::path::PathBuf;

    #[test]
    fn a_gpu_driver_needs_nothing_more_to_run() {
        let hardware = vec![PathBuf::from("nvidia_icd.json")];
        let found = Found { loader: true, hardware, ..Found::default() };
        assert_eq!(missing(&found, false, For::Running), []);
        let more = [Need::Validation, Need::SpirvTools];
        assert_eq!(missing(&found, false, For::Testing), more);
    }

    #[test]
    fn a_bare_machine_needs_loader_and_driver() {
        let needs = missing(&Found::default(), false, For::Running);
        assert_eq!(needs, [Need::Loader, Need::Driver]);
        let software = Some(PathBuf::from("lvp_icd.json"));
        let no_loader = Found { software, ..Found::default() };
        assert_eq!(missing(&no_loader, false, For::Running), [Need::Loader]);
        let text = advice(&needs);
        assert!(text.contains("sudo apt-get install -y --no-install-recommends libvulkan1 mesa-"));
        assert!(text.contains("sudo pacman -S --noconfirm --needed vulkan-icd-loader vulkan-s"));
    }
}
