//! Pipelines, and their cache on disk.

use super::cache;
use super::compiled::Compiled;
use super::descriptors::Layouts;
use super::error::{During, Error};
use super::info::Feature;
use super::logical::Logical;
use super::shader::Shader;
use crate::checksum::crc32;
use crate::lock::lock;
use ash::vk;
use rustc_hash::FxHashMap;
use std::num::NonZero;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Instant;

/// The specialization constant for the workgroup's size in every shader (`glsl/lib/dispatch.glsl`).
const WORKGROUP: u32 = 0;

/// A shader with its constants, ready to be dispatched.
#[derive(Default)]
pub(super) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layouts: Layouts,
    module: vk::ShaderModule,
}

/// The name of a shader, and the values of its constants.
type Key = (&'static str, Vec<u32>);

/// Pipelines of one shader, by the values of its constants.
type Variants = FxHashMap<Vec<u32>, Arc<Pipeline>>;

/// A device's pipelines.
pub(super) struct Pipelines {
    /// The pipelines by shader name and by constants, looked up without copying either.
    made: Mutex<FxHashMap<&'static str, Variants>>,
    cache: vk::PipelineCache,
    file: Option<PathBuf>,
    /// Statistics of the kernels compiled for a device on which nothing runs.
    compiled: Mutex<Vec<Compiled>>,
}

impl Pipeline {
    fn new(
        logical: &Logical,
        cache: vk::PipelineCache,
        shader: &'static Shader,
        constants: &[u32],
    ) -> Result<Self, Error> {
        let mut made = Self::default();
        let laid_out = made.lay_out(logical, shader);
        if let Err(e) = laid_out.and_then(|()| made.specialise(logical, cache, shader, constants)) {
            // SAFETY: no work uses what was made so far.
            unsafe { made.destroy(&logical.raw) };
            return Err(e);
        }
        logical.name(made.raw, shader.name);
        Ok(made)
    }

    /// Makes the module and the layouts of its buffers.
    fn lay_out(&mut self, logical: &Logical, shader: &'static Shader) -> Result<(), Error> {
        let device = &logical.raw;
        let (binder, buffers) = (&logical.binder, shader.bindings.len() as u32);
        let range =
            [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(shader.push_size)];
        let ranges = if shader.push_size > 0 { &range[..] } else { &[] };
        let words = logical.modules.words(shader)?;
        let module_info = vk::ShaderModuleCreateInfo::default().code(&words);
        self.layouts.set = binder.layout(device, buffers)?;
        // SAFETY: the module is SPIR-V that the build validated, its layouts were reflected from the same module, and
        // every pointer outlives its call.
        unsafe {
            let layouts = [self.layouts.set];
            let layout_info =
                vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts).push_constant_ranges(ranges);
            self.layouts.pipeline =
                device.create_pipeline_layout(&layout_info, None).during("create pipeline layout")?;
            self.module = device.create_shader_module(&module_info, None).during("create shader module")?;
        }
        self.layouts.template = binder.template(device, self.layouts.set, self.layouts.pipeline, buffers)?;
        Ok(())
    }

    /// Makes the pipeline itself: the module with its constants.
    fn specialise(
        &mut self,
        logical: &Logical,
        cache: vk::PipelineCache,
        shader: &'static Shader,
        constants: &[u32],
    ) -> Result<(), Error> {
        let subgroup = logical.info.subgroup_size;
        let subgroup_value = shader.subgroup_constant.map(|id| (id, subgroup));
        let backwards_value = shader.backwards_constant.map(|id| (id, u32::from(logical.backwards)));
        let own = shader.constants.iter().copied().zip(constants.iter().copied());
        let (ids, values): (Vec<u32>, Vec<u32>) = own.clone().chain(subgroup_value).chain(backwards_value).unzip();
        let entries: Vec<_> = ids
            .into_iter()
            .zip(0..)
            .map(|(id, i)| vk::SpecializationMapEntry { constant_id: id, offset: i * 4, size: 4 })
            .collect();
        let specialization =
            vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(&values));
        let mut required = logical
            .pinned_subgroup
            .map(|size| vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default().required_subgroup_size(size));
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(self.module)
            .name(c"main")
            .specialization_info(&specialization);
        if let Some(required) = &mut required {
            stage = stage.push_next(required);
        }
        let workgroup = own.clone().find(|(id, _)| *id == WORKGROUP).map_or(1, |(_, workgroup)| workgroup);
        if logical.info.has(Feature::FullSubgroups) && workgroup.is_multiple_of(subgroup) {
            stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
        }
        let flags = if logical.compile_only && logical.executables.is_some() {
            vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR
        } else {
            vk::PipelineCreateFlags::empty()
        };
        let info = [vk::ComputePipelineCreateInfo::default().flags(flags).stage(stage).layout(self.layouts.pipeline)];
        let begun = Instant::now();
        // SAFETY: the layouts were reflected from this module; every pointer outlives the call.
        let made = unsafe { logical.raw.create_compute_pipelines(cache, &info, None) };
        self.raw = made.map_err(|(_, e)| e).during(shader.name)?[0];
        let values: Vec<String> = entries.iter().zip(&values).map(|(e, v)| format!("{}:{v}", e.constant_id)).collect();
        tracing::debug!("pipeline {} {} {:.3} s", shader.name, values.join(","), begun.elapsed().as_secs_f64());
        Ok(())
    }

    /// # Safety
    /// No pending work uses the pipeline.
    unsafe fn destroy(&self, device: &ash::Device) {
        // SAFETY: the caller's promise; the handles were made by this device and are destroyed once.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_descriptor_update_template(self.layouts.template, None);
            device.destroy_pipeline_layout(self.layouts.pipeline, None);
            device.destroy_descriptor_set_layout(self.layouts.set, None);
            device.destroy_shader_module(self.module, None);
        }
    }
}

impl Pipelines {
    /// No pipelines yet, and the driver's cache as saved by an earlier process.
    pub fn new(device: &ash::Device, cache_uuid: [u8; 16]) -> Result<Self, Error> {
        let name = format!("pipelines-{:032x}.bin", u128::from_be_bytes(cache_uuid));
        let file = dirs::cache_dir().map(|d| d.join("qirf-vk").join(name));
        let cached = file.as_ref().and_then(|p| std::fs::read(p).ok()).unwrap_or_default();
        let info = vk::PipelineCacheCreateInfo::default().initial_data(whole(&cached));
        // SAFETY: the data are as `save` got them from a driver, which checks their header and ignores what is not its own.
        let cache = unsafe { device.create_pipeline_cache(&info, None) }.during("create pipeline cache")?;
        Ok(Self { made: Mutex::default(), cache, file, compiled: Mutex::default() })
    }

    /// The pipelines of shaders with the values of their constants, in this order. Missing ones are created in parallel.
    pub fn of<'a>(
        &self,
        logical: &Logical,
        wanted: impl Iterator<Item = (&'static Shader, &'a [u32])> + Clone,
    ) -> Result<Vec<Arc<Pipeline>>, Error> {
        let mut made = lock(&self.made);
        let mut found = Vec::with_capacity(wanted.size_hint().1.unwrap_or(0));
        let mut missing: Vec<(Key, &'static Shader)> = Vec::new();
        for (shader, constants) in wanted.clone() {
            match made.get(shader.name).and_then(|variants| variants.get(constants)) {
                Some(pipeline) => found.push(Arc::clone(pipeline)),
                None => missing.push(((shader.name, constants.to_vec()), shader)),
            }
        }
        if missing.is_empty() {
            return Ok(found);
        }
        missing.sort_unstable_by(|(a, _), (b, _)| a.cmp(b));
        missing.dedup_by(|(a, _), (b, _)| a == b);
        let mut failed = None;
        for ((name, constants), result) in make(logical, self.cache, &missing) {
            match result {
                Ok(pipeline) => {
                    if logical.compile_only {
                        match Compiled::of(logical.executables.as_ref(), (name, &constants), pipeline.raw) {
                            Ok(compiled) => lock(&self.compiled).push(compiled),
                            Err(e) => failed = Some(e),
                        }
                    }
                    made.entry(name).or_default().insert(constants, Arc::new(pipeline));
                }
                Err(e) => failed = Some(e),
            }
        }
        drop(made);
        failed.map_or_else(|| self.of(logical, wanted), Err)
    }

    /// Every pipeline made so far, if nothing runs on the device; ordered by name and constants.
    pub fn compiled(&self) -> Vec<Compiled> {
        let mut all = lock(&self.compiled).clone();
        all.sort_by(|a, b| (a.kernel, &a.constants).cmp(&(b.kernel, &b.constants)));
        all
    }

    /// Writes the driver's cache for the next process, unless it is unchanged.
    pub fn save(&self, device: &ash::Device) {
        let Some(file) = &self.file else { return };
        // SAFETY: the cache is alive.
        let Ok(data) = (unsafe { device.get_pipeline_cache_data(self.cache) }) else { return };
        let stored = [&checksum(&data)[..], &data].concat();
        if std::fs::metadata(file).is_ok_and(|m| m.len() == stored.len() as u64) {
            return;
        }
        // Failing to write the cache only costs the next start some time.
        if let Err(e) = cache::replace(file, &stored) {
            tracing::debug!("the pipeline cache was not saved: {e}");
        }
    }

    /// # Safety
    /// No pending work uses a pipeline, and none is made afterwards.
    pub unsafe fn destroy(&self, device: &ash::Device) {
        // SAFETY: the caller's promise.
        unsafe {
            for (_, variants) in lock(&self.made).drain() {
                for pipeline in variants.values() {
                    pipeline.destroy(device);
                }
            }
            device.destroy_pipeline_cache(self.cache, None);
        }
    }
}

/// The CRC-32 of data of a pipeline cache, which stands before them in the file.
fn checksum(data: &[u8]) -> [u8; 4] {
    crc32([data]).to_le_bytes()
}

/// The data of a pipeline cache as stored; none if the file was cut short or damaged, which not every driver survives.
fn whole(stored: &[u8]) -> &[u8] {
    stored.split_first_chunk::<4>().filter(|(sum, data)| **sum == checksum(data)).map_or(&[], |(_, data)| data)
}

/// Creates pipelines on as many threads as the host has cores. They are dedicated threads: a pool's thread might pick
/// up work that waits for the lock held meanwhile.
fn make(
    logical: &Logical,
    cache: vk::PipelineCache,
    wanted: &[(Key, &'static Shader)],
) -> Vec<(Key, Result<Pipeline, Error>)> {
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    let made = |share: &[(Key, &'static Shader)]| -> Vec<_> {
        share.iter().map(|(key, shader)| (key.clone(), Pipeline::new(logical, cache, shader, &key.1))).collect()
    };
    thread::scope(|scope| {
        let threads = wanted
            .chunks(wanted.len().div_ceil(cores))
            .map(|share| thread::Builder::new().spawn_scoped(scope, || made(share)).map_err(|_| share));
        let threads: Vec<_> = threads.collect();
        let joined = |thread: Result<thread::ScopedJoinHandle<'_, Vec<_>>, _>| match thread {
            Ok(thread) => thread.join().unwrap_or_else(|e| resume_unwind(e)),
            // The system starts no more threads.
            Err(share) => made(share),
        };
        threads.into_iter().flat_map(joined).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_cache_is_empty() {
        let stored = [&checksum(b"header and pipelines")[..], b"header and pipelines"].concat();
        assert_eq!(whole(&stored), b"header and pipelines");
        let mut damaged = stored.clone();
        damaged[12] ^= 1;
        for wrong in [&stored[..stored.len() - 1], &stored[..3], &[], &damaged] {
            assert_eq!(whole(wrong), b"");
        }
    }
}
