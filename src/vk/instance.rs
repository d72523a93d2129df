//! The loader, the instance and the messages of the validation layer.

use std::ffi::{CStr, c_char, c_void};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use ash::{ext, khr, vk};
use raw_window_handle::RawDisplayHandle;

use super::VkError;
use super::process::note_instance;
use crate::fault;

const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Checks of the validation layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validate {
    /// No layer.
    #[default]
    Off,
    /// Core checks and synchronization hazards.
    Sync,
    /// Core checks and shaders instrumented for accesses outside their buffers.
    GpuAssisted,
}

impl Validate {
    /// Reads `INTIMA_VALIDATE`: `1` is [`Validate::Sync`], `gpu` is [`Validate::GpuAssisted`].
    pub fn from_env() -> Self {
        match std::env::var("INTIMA_VALIDATE").as_deref() {
            Ok("gpu") => Self::GpuAssisted,
            Ok("" | "0") | Err(_) => Self::Off,
            Ok(_) => Self::Sync,
        }
    }
}

/// Messages of the layer in this process, from every device.
static ALL_MESSAGES: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Returns the messages of the validation layer in this process, severity warning and above, from
/// every device opened so far. They include those about resources that are left when a device is
/// destroyed.
pub fn all_validation_messages() -> Vec<String> {
    ALL_MESSAGES.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Messages of the layer about one instance, severity warning and above.
#[derive(Default)]
struct Messages(Mutex<Vec<String>>);

/// Loader, instance and, when validating, the messenger.
pub(super) struct Instance {
    // The fields are dropped after `Drop::drop` has destroyed the instance, so both the library
    // and the list of messages outlive every callback.
    pub entry: ash::Entry,
    pub raw: ash::Instance,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    messages: Box<Messages>,
    pub validate: Validate,
    /// Whether the driver has to stay loaded when this instance is gone.
    keeps_driver: bool,
}

/// Libraries that are driver and loader in one, where a machine may have no loader: MoltenVK of a
/// system, and of an application that brings it along.
const DRIVERS_ALONE: &[&str] = if cfg!(target_os = "macos") {
    &["libMoltenVK.dylib", "@executable_path/../Frameworks/libMoltenVK.dylib"]
} else {
    &[]
};

/// Whether an instance was left alive so that the driver of a graphics card stays loaded.
static DRIVER_KEPT: AtomicBool = AtomicBool::new(false);

impl Instance {
    /// Keeps the driver loaded to the end of the process. Drivers of graphics cards run code at the
    /// end of each thread that called them; unloaded with the last instance, that code is gone, and
    /// a thread that ends later takes the process with it (seen with NVIDIA's 580.159).
    pub fn keep_driver(&mut self) {
        self.keeps_driver = true;
    }

    /// Creates an instance.
    ///
    /// * `display`: display of the windows that will be drawn to, if any.
    pub fn new(validate: Validate, display: Option<RawDisplayHandle>) -> Result<Self, VkError> {
        note_instance();
        if fault::hit(fault::Point::Instance) {
            return Err(VkError::NoDriver);
        }
        // SAFETY: loads the system's Vulkan loader; running its initialisers is the purpose. The
        // library stays loaded as long as the entry lives, which is as long as this instance.
        let loaded = unsafe { ash::Entry::load() };
        let entry = loaded.or_else(|e| {
            // SAFETY: as above, of a driver that is its own loader.
            let driver = |name: &&str| unsafe { ash::Entry::load_from(name) }.ok();
            DRIVERS_ALONE.iter().find_map(driver).ok_or(e)
        });
        let entry = entry.map_err(|e| VkError::NoLibrary(e.to_string()))?;
        // SAFETY: a global command of a loaded library; touches no object of ours.
        let version = unsafe { entry.try_enumerate_instance_version() }
            .map_err(VkError::of("vkEnumerateInstanceVersion"))?
            .unwrap_or(vk::API_VERSION_1_0);
        if version < vk::API_VERSION_1_3 {
            return Err(VkError::NoDevice {
                wanted: "Vulkan 1.3".into(),
                found: format!("a loader for Vulkan {}", dotted(version)),
                lacking: true,
            });
        }
        let on = validate != Validate::Off;
        if on && !has_layer(&entry)? {
            return Err(VkError::NoValidation("VK_LAYER_KHRONOS_validation"));
        }

        let messages = Box::<Messages>::default();
        let mut messenger_info = messenger_info(&messages);
        let app = vk::ApplicationInfo::default()
            .application_name(c"intima")
            .api_version(vk::API_VERSION_1_3);
        let layers = [LAYER.as_ptr()];
        let mut extensions = Vec::new();
        let mut flags = vk::InstanceCreateFlags::empty();
        // Without it the loader hides drivers that translate Vulkan to another interface, as all
        // do on macOS.
        if has_extension(&entry, khr::portability_enumeration::NAME)? {
            extensions.push(khr::portability_enumeration::NAME.as_ptr());
            flags |= vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
        }
        if on {
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        if let Some(display) = display {
            let wanted = ash_window::enumerate_required_extensions(display)
                .map_err(|_| VkError::NoSurface("this kind of display is not known"))?;
            extensions.extend(wanted);
        }
        let checks: &[_] = match validate {
            Validate::GpuAssisted => &[
                vk::ValidationFeatureEnableEXT::GPU_ASSISTED,
                vk::ValidationFeatureEnableEXT::GPU_ASSISTED_RESERVE_BINDING_SLOT,
            ],
            _ => &[vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION],
        };
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(checks);
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&app)
            .enabled_extension_names(&extensions)
            .flags(flags);
        if on {
            info = info
                .enabled_layer_names(&layers)
                .push_next(&mut messenger_info)
                .push_next(&mut features);
        }
        // SAFETY: `info` and all it points to live until the call returns; the messages that the
        // chained messenger writes to are boxed and live longer than the instance.
        let raw = unsafe { entry.create_instance(&info, None) }.map_err(|result| match result {
            vk::Result::ERROR_EXTENSION_NOT_PRESENT if display.is_some() => {
                VkError::NoSurface("no driver draws to windows of this display")
            }
            vk::Result::ERROR_INCOMPATIBLE_DRIVER => VkError::NoDriver,
            result => VkError::of("vkCreateInstance")(result),
        })?;
        let mut instance =
            Self { entry, raw, messenger: None, messages, validate, keeps_driver: false };
        if on {
            VkError::planted("vkCreateDebugUtilsMessengerEXT")?;
            let utils = ext::debug_utils::Instance::new(&instance.entry, &instance.raw);
            // SAFETY: the instance was just created with the extension; the user data is the boxed
            // list, which outlives the messenger (see `Drop`).
            let messenger = unsafe {
                utils.create_debug_utils_messenger(&self::messenger_info(&instance.messages), None)
            }
            .map_err(VkError::of("vkCreateDebugUtilsMessengerEXT"))?;
            instance.messenger = Some((utils, messenger));
        }
        Ok(instance)
    }

    pub fn messages(&self) -> Vec<String> {
        self.messages.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub fn physical_devices(&self) -> Result<Vec<vk::PhysicalDevice>, VkError> {
        // SAFETY: a query on our live instance.
        unsafe { self.raw.enumerate_physical_devices() }.map_err(|result| match result {
            // Some loaders answer so when every driver fails to start.
            vk::Result::ERROR_INITIALIZATION_FAILED => VkError::NoDriver,
            result => VkError::of("vkEnumeratePhysicalDevices")(result),
        })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // One instance that stays holds the loader and the driver for all later ones.
        let stays = self.keeps_driver && !DRIVER_KEPT.swap(true, Ordering::SeqCst);
        // SAFETY: both handles are ours and go once, messenger before instance; the device was
        // dropped before (it borrows nothing, `Gpu` orders its fields), so nothing uses them. What
        // an instance that stays may reach, its library and its messages, stays with it.
        unsafe {
            if let Some((utils, messenger)) = self.messenger.take() {
                utils.destroy_debug_utils_messenger(messenger, None);
            }
            if stays {
                std::mem::forget(self.entry.clone());
                let none = Box::new(Messages(Mutex::default()));
                std::mem::forget(std::mem::replace(&mut self.messages, none));
            } else {
                self.raw.destroy_instance(None);
            }
        }
    }
}

/// Formats a packed version as `1.3.230`.
pub(super) fn dotted(v: u32) -> String {
    let (major, minor) = (vk::api_version_major(v), vk::api_version_minor(v));
    format!("{major}.{minor}.{}", vk::api_version_patch(v))
}

fn has_layer(entry: &ash::Entry) -> Result<bool, VkError> {
    // SAFETY: a global query of a loaded library.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }
        .map_err(VkError::of("vkEnumerateInstanceLayerProperties"))?;
    Ok(layers.iter().any(|l| l.layer_name_as_c_str() == Ok(LAYER)))
}

fn has_extension(entry: &ash::Entry, name: &CStr) -> Result<bool, VkError> {
    // SAFETY: a global query of a loaded library.
    let there = unsafe { entry.enumerate_instance_extension_properties(None) }
        .map_err(VkError::of("vkEnumerateInstanceExtensionProperties"))?;
    Ok(there.iter().any(|e| e.extension_name_as_c_str() == Ok(name)))
}

fn messenger_info(messages: &Messages) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    // Of the types, only validation counts: the loader's own complaints about drivers for absent
    // hardware are "general", advice on performance is noise.
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(
            vk::DebugUtilsMessageSeverityFlagsEXT::WARNING
                | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
        )
        .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
        .pfn_user_callback(Some(on_message))
        .user_data(std::ptr::from_ref(messages).cast_mut().cast())
}

unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _types: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes a live struct whose strings are null or NUL-terminated for the time
    // of the call; `user` is the `Messages` given at creation, shared behind its mutex.
    let (id, text, messages) = unsafe {
        let data = &*data;
        (string(data.p_message_id_name), string(data.p_message), &*user.cast::<Messages>())
    };
    let message = format!("{id}: {text}");
    ALL_MESSAGES.lock().unwrap_or_else(PoisonError::into_inner).push(message.clone());
    messages.0.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    vk::FALSE
}

/// # Safety
/// `p` is null or points to a NUL-terminated string.
unsafe fn string(p: *const c_char) -> String {
    if p.is_null() {
        return String::new();
    }
    // SAFETY: by the contract above.
    unsafe { CStr::from_ptr(p) }.to_string_lossy().into_owned()
}
