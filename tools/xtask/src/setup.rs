//! Installs missing Vulkan packages through the system's package manager.

use crate::process::{command, on_path, run, succeeds};
use crate::{TaskError, vulkan};

/// What the machine is set up for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Running intima: a loader and a driver.
    Running,
    /// Testing it: also the validation layer, an X server without a screen, and a program that
    /// presses keys there.
    Testing,
}

/// Something that may be missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Package {
    Loader,
    Driver,
    Validation,
    XServer,
    Xdotool,
}

/// A package manager: program, how it installs, how it refreshes its lists, its names for things.
struct Manager {
    program: &'static str,
    install: &'static [&'static str],
    refresh: &'static [&'static str],
    names: fn(Package) -> &'static str,
}

const MANAGERS: &[Manager] = &[
    Manager {
        program: "apt-get",
        install: &["install", "-y", "--no-install-recommends"],
        refresh: &["update"],
        names: |need| match need {
            Package::Loader => "libvulkan1",
            Package::Driver => "mesa-vulkan-drivers",
            Package::Validation => "vulkan-validationlayers",
            Package::XServer => "xvfb",
            Package::Xdotool => "xdotool",
        },
    },
    Manager {
        program: "dnf",
        install: &["install", "-y"],
        refresh: &["makecache"],
        names: |need| match need {
            Package::Loader => "vulkan-loader",
            Package::Driver => "mesa-vulkan-drivers",
            Package::Validation => "vulkan-validation-layers",
            Package::XServer => "xorg-x11-server-Xvfb",
            Package::Xdotool => "xdotool",
        },
    },
    Manager {
        program: "pacman",
        install: &["-S", "--noconfirm", "--needed"],
        refresh: &["-Sy"],
        names: |need| match need {
            Package::Loader => "vulkan-icd-loader",
            Package::Driver => "vulkan-swrast",
            Package::Validation => "vulkan-validation-layers",
            Package::XServer => "xorg-server-xvfb",
            Package::Xdotool => "xdotool",
        },
    },
];

/// Installs what is missing, or says exactly what to install.
pub fn setup(purpose: Purpose) -> Result<(), TaskError> {
    let needs = missing(&vulkan::detect(), &on_path, purpose);
    if needs.is_empty() {
        return Ok(());
    }
    eprintln!("missing: {needs:?}");
    let manager = MANAGERS.iter().find(|m| on_path(m.program));
    let (Some(manager), Some(prefix)) = (manager, rights()) else {
        return Err(TaskError::NoDevice(advice(&needs)));
    };
    install(manager, prefix, &needs).map_err(|_| TaskError::NoDevice(advice(&needs)))?;
    let still = missing(&vulkan::detect(), &on_path, purpose);
    if still.is_empty() { Ok(()) } else { Err(TaskError::NoDevice(advice(&still))) }
}

/// * `has`: whether a program is in the search path.
fn missing(found: &vulkan::Detected, has: &dyn Fn(&str) -> bool, purpose: Purpose) -> Vec<Package> {
    let testing = purpose == Purpose::Testing;
    let all = [
        (Package::Loader, found.loader),
        (Package::Driver, found.driver()),
        (Package::Validation, found.validation || !testing),
        (Package::XServer, !testing || has("Xvfb")),
        (Package::Xdotool, !testing || has("xdotool")),
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
        succeeds(&mut command("sudo", &["-n", "true"])).then_some(&["sudo", "-n"])
    }
}

/// Installs at once; if that fails, the lists may be old or absent: refreshes them and tries again.
fn install(manager: &Manager, prefix: &[&str], needs: &[Package]) -> Result<(), TaskError> {
    let names: Vec<_> = needs.iter().map(|n| (manager.names)(*n)).collect();
    let with = |args: &[&str]| {
        // `env`, because sudo drops variables: no package may stop to ask.
        let start = ["env", "DEBIAN_FRONTEND=noninteractive", manager.program];
        let words = [prefix, &start, args].concat();
        run(&mut command(words[0], &words[1..]))
    };
    let install = [manager.install, &names].concat();
    with(&install).or_else(|_| {
        with(manager.refresh)?;
        with(&install)
    })
}

/// The commands to type, for every package manager we know.
fn advice(needs: &[Package]) -> String {
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
    use crate::vulkan::Detected;
    use std::path::PathBuf;

    #[test]
    fn a_gpu_driver_is_enough_to_run() {
        let hardware = vec![PathBuf::from("nvidia_icd.json")];
        let found = Detected { loader: true, hardware, ..Detected::default() };
        assert_eq!(missing(&found, &|_| false, Purpose::Running), []);
        let more = [Package::Validation, Package::XServer, Package::Xdotool];
        assert_eq!(missing(&found, &|_| false, Purpose::Testing), more);
    }

    #[test]
    fn a_bare_machine_needs_loader_and_driver() {
        let needs = missing(&Detected::default(), &|_| false, Purpose::Running);
        assert_eq!(needs, [Package::Loader, Package::Driver]);
        let software = Some(PathBuf::from("lvp_icd.json"));
        let no_loader = Detected { software, ..Detected::default() };
        assert_eq!(missing(&no_loader, &|_| false, Purpose::Running), [Package::Loader]);
        let text = advice(&needs);
        assert!(text.contains("sudo apt-get install -y --no-install-recommends libvulkan1 mesa-"));
        assert!(text.contains("sudo pacman -S --noconfirm --needed vulkan-icd-loader vulkan-s"));
    }
}
