//! The Vulkan instance, and validation layers whose messages are counted.

use super::error::{During, Error};
use ash::{ext, khr, vk};
use std::ffi::{CStr, c_void};
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};

static MESSAGES: AtomicUsize = AtomicUsize::new(0);

/// Validation warnings and errors seen by this process so far.
pub(super) fn validation_messages() -> usize {
    MESSAGES.load(Ordering::SeqCst)
}

pub(super) struct Instance {
    pub raw: ash::Instance,
    pub debug_utils: bool,
    pub validation: bool,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    _entry: ash::Entry,
}

const VALIDATION: &CStr = c"VK_LAYER_KHRONOS_validation";

impl Instance {
    pub fn new(validation: bool) -> Result<Self, Error> {
        // SAFETY: loading the system's Vulkan loader runs its initialisers; we trust the installed loader.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::NoLoader(e.to_string()))?;
        // SAFETY: `entry` is alive; these calls have no other precondition.
        let (extensions, layers) = unsafe {
            (
                entry.enumerate_instance_extension_properties(None).during("enumerate instance extensions")?,
                entry.enumerate_instance_layer_properties().during("enumerate layers")?,
            )
        };
        let has_layer = layers.iter().any(|l| l.layer_name_as_c_str() == Ok(VALIDATION));
        if validation && !has_layer {
            tracing::warn!("validation was requested, but its layer is not installed (vulkan-validationlayers)");
        }
        let validation = validation && has_layer;
        let offered = |name| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
        let debug_utils = offered(ext::debug_utils::NAME) || validation;
        // Loaders hide devices that lack parts of Vulkan, such as Apple's, unless the program asks for them.
        let portability = offered(khr::portability_enumeration::NAME);

        // SAFETY: as above; the layer is there.
        let of_layer = unsafe { entry.enumerate_instance_extension_properties(validation.then_some(VALIDATION)) };
        let of_layer = of_layer.during("enumerate the layer's extensions")?;
        let settings_offered =
            validation && of_layer.iter().any(|e| e.extension_name_as_c_str() == Ok(ext::layer_settings::NAME));

        let mut names = Vec::new();
        let mut enabled_layers = Vec::new();
        if debug_utils {
            names.push(ext::debug_utils::NAME.as_ptr());
        }
        if portability {
            names.push(khr::portability_enumeration::NAME.as_ptr());
        }
        if validation {
            enabled_layers.push(VALIDATION.as_ptr());
            names.push(ext::validation_features::NAME.as_ptr());
        }
        let application = vk::ApplicationInfo::default()
            .application_name(c"qirf-vk")
            .engine_name(c"qirf-vk")
            .api_version(vk::API_VERSION_1_2);
        // Synchronisation validation finds a missing barrier that a driver running commands in order would hide.
        let checks = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&checks);
        let flags = if portability {
            vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR
        } else {
            vk::InstanceCreateFlags::empty()
        };
        let mut info = vk::InstanceCreateInfo::default()
            .flags(flags)
            .application_info(&application)
            .enabled_extension_names(&names)
            .enabled_layer_names(&enabled_layers);
        if validation {
            info = info.push_next(&mut features);
        }
        // Newer layers check kernels' buffers only on request. Older ones have no settings, and check across
        // submissions only if the environment says so (.cargo/config.toml). The layer reads its settings from the
        // chain; the extension's name is left out, because loaders that do not know it refuse it.
        let on = vk::TRUE;
        let shaders = [vk::LayerSettingEXT {
            p_layer_name: VALIDATION.as_ptr(),
            p_setting_name: c"syncval_shader_accesses_heuristic".as_ptr(),
            ty: vk::LayerSettingTypeEXT::BOOL32,
            value_count: 1,
            p_values: (&raw const on).cast(),
            ..vk::LayerSettingEXT::default()
        }];
        let mut settings = vk::LayerSettingsCreateInfoEXT::default().settings(&shaders);
        if settings_offered {
            info = info.push_next(&mut settings);
        }
        // SAFETY: all pointers in `info` outlive the call.
        let raw = match unsafe { entry.create_instance(&info, None) } {
            Err(vk::Result::ERROR_INCOMPATIBLE_DRIVER) => return Err(Error::NoDriver),
            other => other.during("create instance")?,
        };
        let messenger = validation.then(|| {
            let debug = ext::debug_utils::Instance::new(&entry, &raw);
            let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
                .message_severity(
                    vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
                )
                .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
                .pfn_user_callback(Some(on_message));
            // SAFETY: the callback is a plain function that lives as long as the program.
            unsafe { debug.create_debug_utils_messenger(&info, None) }.ok().map(|m| (debug, m))
        });
        Ok(Self { raw, debug_utils, validation, messenger: messenger.flatten(), _entry: entry })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: the device and all its children are gone: `Context` drops its instance last.
        unsafe {
            if let Some((debug, messenger)) = self.messenger.take() {
                debug.destroy_debug_utils_messenger(messenger, None);
            }
            self.raw.destroy_instance(None);
        }
    }
}

/// Counts and prints a validation message.
unsafe extern "system" fn on_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    _: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes a valid structure for the length of this call.
    let text = unsafe { data.as_ref().and_then(|d| d.message_as_c_str()) };
    let text = text.map_or_else(|| "a message without text".into(), |t| t.to_string_lossy());
    MESSAGES.fetch_add(1, Ordering::SeqCst);
    // Without a panic if standard error is closed.
    let _ = writeln!(std::io::stderr(), "validation: {text}");
    vk::FALSE
}
