//! Devices with modified shaders: with a mistake in one, or all rewritten.

use super::device::opened;
use qirf_vk::gpu::{Device, DeviceOptions};
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// A mistake: a text of this file below `glsl` is replaced by another.
pub struct Mistake {
    pub file: &'static str,
    pub right: &'static str,
    pub wrong: &'static str,
    /// The shaders affected, as `ROOM/STAGE`.
    pub shaders: &'static [&'static str],
}

impl Mistake {
    /// A device that makes this mistake; its modules must exist as long as it creates pipelines.
    pub fn device(&self) -> (Device, TempDir) {
        let folder = self.modules();
        let mut options = DeviceOptions::from_env().unwrap();
        options.harness.shaders = Some(folder.path().to_owned());
        (Device::open(&options).unwrap(), folder)
    }

    /// A folder with the modules of the affected shaders.
    pub fn modules(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("glsl");
        let text = fs::read_to_string(sources.join(self.file)).unwrap();
        assert_eq!(text.matches(self.right).count(), 1, "{}: {}", self.file, self.right);
        // Includes are searched in this folder first.
        let changed = folder.path().join(self.file);
        fs::create_dir_all(changed.parent().unwrap()).unwrap();
        fs::write(&changed, text.replace(self.right, self.wrong)).unwrap();
        for shader in self.shaders {
            let own = folder.path().join(format!("{shader}.comp"));
            let source = if own.is_file() { own } else { sources.join(format!("{shader}.comp")) };
            let module = folder.path().join(format!("{}.spv", shader.replace('/', "-")));
            let compiled = Command::new("glslc")
                .args(["-fshader-stage=compute", "--target-env=vulkan1.2", "--target-spv=spv1.5", "-O0"])
                .args([Path::new("-I"), folder.path(), Path::new("-I"), &sources, &source, Path::new("-o"), &module])
                .status();
            assert!(compiled.expect("glslc: run tools/setup").success(), "{shader}");
        }
        folder
    }
}

/// A validated device with the modules of this folder, each rewritten, and with changed options; the modules must exist as long
/// as it creates pipelines.
pub fn rewritten(
    modules: &Path,
    change: impl FnOnce(&mut DeviceOptions),
    mut rewrite: impl FnMut(&[u32]) -> Vec<u32>,
) -> (Device, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(modules).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "spv") {
            let bytes = fs::read(&path).unwrap();
            let words: Vec<u32> = bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
            let bytes: Vec<u8> = rewrite(&words).iter().flat_map(|w| w.to_le_bytes()).collect();
            fs::write(folder.path().join(entry.file_name()), bytes).unwrap();
        }
    }
    let device = opened(|options| {
        change(options);
        options.harness.shaders = Some(folder.path().to_owned());
    });
    (device, folder)
}
