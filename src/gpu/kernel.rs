//! Shaders as the build script reflected them, and their pipelines.

use super::buffer::RawBuffer;
use super::device::Context;
use super::error::{During, Error};
use ash::vk;

/// What a kernel does with a binding, from the shader's own qualifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// `readonly`.
    Read,
    /// `writeonly`: every element that counts is written.
    Write,
    /// Neither.
    ReadWrite,
}

/// One binding of a shader.
#[derive(Clone, Copy, Debug)]
pub struct BindingInfo {
    /// Its name in the shader.
    pub name: &'static str,
    /// What the kernel does with it.
    pub access: Access,
}

/// A compute shader: SPIR-V and what was reflected from it.
#[derive(Debug)]
pub struct Shader {
    /// `room/stage`: the debug label and profiler name.
    pub name: &'static str,
    /// The module, little-endian words.
    pub spirv: &'static [u8],
    /// Bindings 0, 1, ...
    pub bindings: &'static [BindingInfo],
    /// Bytes of push constants.
    pub push_size: u32,
    /// Identifiers of the specialization constants, in the order of [`Kernel::constants`].
    pub constants: &'static [u32],
    /// The constant that receives the subgroup size, if any.
    pub subgroup_constant: Option<u32>,
}

/// A shader with its arguments; implemented by the generated structs of `crate::kernels`.
pub trait Kernel {
    /// The shader.
    fn shader(&self) -> &'static Shader;
    /// The buffers in binding order.
    fn buffers(&self) -> Vec<&RawBuffer>;
    /// The push constants' bytes.
    fn push_bytes(&self) -> &[u8];
    /// Values of the specialization constants, as bits.
    fn constants(&self) -> Vec<u32>;
}

pub(super) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    set_layout: vk::DescriptorSetLayout,
    module: vk::ShaderModule,
}

/// A pipeline is a shader with its constants.
pub(super) type PipelineKey = (&'static str, Vec<u32>);

impl Pipeline {
    pub fn new(context: &Context, shader: &'static Shader, constants: &[u32]) -> Result<Self, Error> {
        let device = &context.raw;
        let bindings: Vec<_> = (0..shader.bindings.len() as u32)
            .map(|i| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(i)
                    .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let set_info = vk::DescriptorSetLayoutCreateInfo::default()
            .flags(vk::DescriptorSetLayoutCreateFlags::PUSH_DESCRIPTOR_KHR)
            .bindings(&bindings);
        let words: Vec<u32> =
            shader.spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();

        let mut values = constants.to_vec();
        let mut ids = shader.constants.to_vec();
        if let Some(id) = shader.subgroup_constant {
            ids.push(id);
            values.push(context.info.subgroup_size);
        }
        let entries: Vec<_> = ids
            .iter()
            .zip(0..)
            .map(|(id, i)| vk::SpecializationMapEntry { constant_id: *id, offset: i * 4, size: 4 })
            .collect();
        let specialization =
            vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(&values));

        let range =
            [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(shader.push_size)];
        let ranges = if shader.push_size > 0 { &range[..] } else { &[] };
        let mut made = Self {
            raw: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            module: vk::ShaderModule::null(),
        };
        // SAFETY: the module is SPIR-V that the build validated, its layouts were reflected from the same module, and
        // every pointer outlives its call.
        let complete = (|| unsafe {
            made.set_layout = device.create_descriptor_set_layout(&set_info, None).during("create set layout")?;
            let layouts = [made.set_layout];
            let layout_info =
                vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts).push_constant_ranges(ranges);
            made.layout = device.create_pipeline_layout(&layout_info, None).during("create pipeline layout")?;
            let module_info = vk::ShaderModuleCreateInfo::default().code(&words);
            made.module = device.create_shader_module(&module_info, None).during("create shader module")?;
            let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default()
                .required_subgroup_size(context.info.subgroup_size);
            let mut stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(made.module)
                .name(c"main")
                .specialization_info(&specialization);
            if context.subgroup_control {
                stage = stage.push_next(&mut required);
            }
            let info = [vk::ComputePipelineCreateInfo::default().stage(stage).layout(made.layout)];
            made.raw = device
                .create_compute_pipelines(context.pipeline_cache, &info, None)
                .map_err(|(_, e)| e)
                .during(shader.name)?[0];
            Ok(())
        })();
        if let Err(e) = complete {
            // SAFETY: no work uses what was made so far.
            unsafe { made.destroy(device) };
            return Err(e);
        }
        context.name_object(made.raw, shader.name);
        Ok(made)
    }

    /// # Safety
    /// No submitted work may still use the pipeline.
    pub unsafe fn destroy(&self, device: &ash::Device) {
        // SAFETY: the caller's promise; the handles were made by this device and are destroyed once.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
            device.destroy_shader_module(self.module, None);
        }
    }
}
