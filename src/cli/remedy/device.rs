//! Remedies for errors of devices and their memory.

use super::plain;
use crate::gpu;
use crate::job::Relief;
use std::env::consts::OS;

/// Advice on an error of the device floor.
pub(super) fn device(error: &gpu::Error) -> Option<String> {
    match error {
        gpu::Error::NoLoader(_) | gpu::Error::NoDriver | gpu::Error::NoDevice => plain(vulkan(error, OS)),
        gpu::Error::MissingFeature { .. } => plain("choose another device with --device, or update its driver"),
        gpu::Error::Driver { .. } => plain(
            "install Mesa 25 or newer (Debian 12: mesa-vulkan-drivers from bookworm-backports; tools/setup does it), or use a GPU",
        ),
        gpu::Error::TooLarge { .. } => plain("use fewer Gaussians, a smaller image, or another device"),
        gpu::Error::OutOfMemory { .. } => {
            plain("use fewer Gaussians, a smaller image, another device, or a larger --memory-budget if you set one")
        }
        gpu::Error::Exhausted { .. } => {
            plain("end other programs that use it, or use fewer Gaussians, a smaller image, or another device")
        }
        gpu::Error::Lost(_) => plain(
            "run the same command again, with --resume if it has this option; if it fails again, try a newer driver, a \
             longer watchdog of the driver or shorter submissions (--max-submission 500), a smaller --resolution, or \
             another --device",
        ),
        gpu::Error::NoFreeDevice { .. } => plain("wait for one of them, or choose a device with --device"),
        gpu::Error::HiddenDevices { .. } => plain(
            "change that variable, or name a device by index or address with --device (qirf-vk device lists them)",
        ),
        gpu::Error::Lease { .. } => plain("name another folder with QIRF_LEASES"),
        gpu::Error::UnknownDevice { .. }
        | gpu::Error::Address(_)
        | gpu::Error::Tuning(_)
        | gpu::Error::Variable { .. }
        | gpu::Error::Shader { .. }
        | gpu::Error::Vulkan { .. } => None,
    }
}

/// Advice on a system without Vulkan.
fn vulkan(error: &gpu::Error, system: &str) -> &'static str {
    match (error, system) {
        (_, "windows") => "install or update your GPU's driver, which brings Vulkan (vulkan-1.dll)",
        (_, "macos") => "install Vulkan by `brew install vulkan-loader molten-vk`",
        (gpu::Error::NoLoader(_), _) => "install it (Debian and Ubuntu: libvulkan1, or run tools/setup)",
        (gpu::Error::NoDriver, _) => {
            "install your GPU's driver, or mesa-vulkan-drivers for a software device; NVIDIA's also needs libglvnd0 (libGLdispatch.so.0) \
             and, in a container, NVIDIA_DRIVER_CAPABILITIES=all; VK_LOADER_DEBUG=error lists the drivers that were tried"
        }
        _ => "install your GPU's driver, or mesa-vulkan-drivers for a software device",
    }
}

/// Advice on running a job with less memory, or with smaller buffers.
pub(super) fn smaller(relief: Relief, buffers: bool) -> String {
    let mut ways = match relief {
        Relief::None | Relief::OtherDevice => Vec::new(),
        Relief::Gaussians { most, degree } => {
            let degree = degree.map(|degree| format!("--sh-degree {degree}"));
            std::iter::once(format!("--max-gaussians {most}")).chain(degree).collect()
        }
        Relief::SmallerModel => vec!["a smaller model".to_owned()],
        Relief::SmallerPictures => vec!["a smaller --size".to_owned()],
        Relief::MoreBlocks => vec!["more --blocks in a new plan".to_owned()],
    };
    // Where fewer Gaussians help, the largest buffer does not depend on the pictures' size.
    let pictures = if buffers { relief == Relief::None } else { relief != Relief::OtherDevice };
    if pictures {
        ways.push("a smaller --resolution".to_owned());
    }
    if !buffers {
        ways.push("a larger --memory-budget (if it was set)".to_owned());
    }
    let ways = if ways.is_empty() { String::new() } else { format!("{}, or ", ways.join(", ")) };
    let last = match relief {
        Relief::Gaussians { .. } => ", or train in blocks: `qirf-vk shard plan run --help`",
        Relief::OtherDevice => ": an interrupted run keeps its options",
        _ => "",
    };
    format!("give {ways}another --device{last}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drivers_are_those_of_the_system_and_options_those_that_help() {
        assert!(vulkan(&gpu::Error::NoDriver, "macos").contains("brew install vulkan-loader molten-vk"));
        assert!(vulkan(&gpu::Error::NoDevice, "windows").contains("vulkan-1.dll"));
        assert!(device(&gpu::Error::Lost("a wait")).is_some_and(|told| told.contains("--max-submission")));
        let large = gpu::Error::TooLarge { name: "sh2".into(), needed: 2, limit: 1, device: "D".into() };
        assert!(device(&large).is_some_and(|told| !told.contains("compress") && !told.contains("--selector")));
        for (relief, buffers, told) in [
            (Relief::None, true, "give a smaller --resolution, or another --device"),
            (Relief::OtherDevice, true, "give another --device: an interrupted run keeps its options"),
            (Relief::MoreBlocks, true, "give more --blocks in a new plan, or another --device"),
            (Relief::OtherDevice, false, "give a larger --memory-budget (if it was set), or another --device: an"),
            (Relief::None, false, "give a smaller --resolution, a larger --memory-budget (if it was set), or another"),
        ] {
            assert!(smaller(relief, buffers).starts_with(told), "{}", smaller(relief, buffers));
        }
        let fewer = |degree| Relief::Gaussians { most: 7, degree };
        assert!(smaller(fewer(None), false).starts_with("give --max-gaussians 7, a smaller --resolution, a larger"));
        let told =
            "give --max-gaussians 7, --sh-degree 1, or another --device, or train in blocks: `qirf-vk shard plan";
        assert!(smaller(fewer(Some(1)), true).starts_with(told));
    }
}
