//! Binding of buffers to kernels: by push descriptors, or by descriptor sets on devices that lack these.

use super::error::{During, Error};
use super::info::{DeviceInfo, Feature};
use ash::{khr, vk};
use std::str::FromStr;

/// A way to bind buffers to kernels. Results do not depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descriptors {
    /// `VK_KHR_push_descriptor`: bound inside the command buffer.
    Push,
    /// A descriptor set per dispatch, from a pool of the submission: every device supports this.
    Sets,
}

impl Descriptors {
    /// The way that was chosen; otherwise push descriptors if the device has them.
    pub(super) fn choose(chosen: Option<Self>, info: &DeviceInfo) -> Result<Self, Error> {
        match (chosen, info.has(Feature::PushDescriptors)) {
            (Some(Self::Push), false) => Err(Error::MissingFeature {
                device: info.name.clone(),
                feature: "VK_KHR_push_descriptor, which was requested".to_owned(),
            }),
            (Some(chosen), _) => Ok(chosen),
            (None, true) => Ok(Self::Push),
            (None, false) => Ok(Self::Sets),
        }
    }
}

impl FromStr for Descriptors {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "push" => Ok(Self::Push),
            "sets" => Ok(Self::Sets),
            other => Err(format!("'{other}' is neither push nor sets")),
        }
    }
}

/// Binds buffers in the device's way. Update templates read the same array of buffers in both.
pub(super) enum Binder {
    Push(khr::push_descriptor::Device),
    Sets,
}

/// The layouts of a pipeline, and the template that binds its buffers.
#[derive(Clone, Copy, Default)]
pub(super) struct Layouts {
    pub set: vk::DescriptorSetLayout,
    pub pipeline: vk::PipelineLayout,
    pub template: vk::DescriptorUpdateTemplate,
}

/// A submission's pool of descriptor sets. Empty with push descriptors.
#[derive(Default)]
pub(super) struct Sets {
    pool: vk::DescriptorPool,
    room: Room,
}

/// A number of descriptor sets, and of buffers in all of them together.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Room {
    pub sets: u32,
    pub buffers: u32,
}

impl Sets {
    /// Empties the pool, or creates a larger one if the next recording needs it.
    ///
    /// # Safety
    /// No pending work uses the sets.
    pub unsafe fn prepare(&mut self, device: &ash::Device, wanted: Room) -> Result<(), Error> {
        if wanted.sets == 0 {
            return Ok(());
        }
        let Room { sets, buffers } = self.room;
        if wanted.sets <= sets && wanted.buffers <= buffers {
            // SAFETY: the pool is alive, since it has room, and the caller promises that its sets are idle.
            return unsafe { device.reset_descriptor_pool(self.pool, vk::DescriptorPoolResetFlags::empty()) }
                .during("reset descriptor sets");
        }
        // SAFETY: the caller's promise.
        unsafe { std::mem::take(self).destroy(device) };
        let room = Room {
            sets: wanted.sets.max(sets).next_power_of_two(),
            buffers: wanted.buffers.max(buffers).next_power_of_two(),
        };
        let size = vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count: room.buffers };
        let sizes = [size];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(room.sets).pool_sizes(&sizes);
        // SAFETY: the sizes outlive the call.
        let pool = unsafe { device.create_descriptor_pool(&info, None) }.during("create descriptor pool")?;
        *self = Self { pool, room };
        Ok(())
    }

    /// # Safety
    /// No pending work uses the sets.
    pub unsafe fn destroy(self, device: &ash::Device) {
        // SAFETY: the caller's promise; the pool is destroyed once, and with it its sets.
        unsafe { device.destroy_descriptor_pool(self.pool, None) };
    }
}

impl Binder {
    pub fn new(way: Descriptors, instance: &ash::Instance, device: &ash::Device) -> Self {
        match way {
            Descriptors::Push => Self::Push(khr::push_descriptor::Device::new(instance, device)),
            Descriptors::Sets => Self::Sets,
        }
    }

    /// The layout of storage buffers 0 to `count`.
    pub fn layout(&self, device: &ash::Device, count: u32) -> Result<vk::DescriptorSetLayout, Error> {
        let binding = vk::DescriptorSetLayoutBinding::default()
            .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::COMPUTE);
        let bindings: Vec<_> = (0..count).map(|i| binding.binding(i)).collect();
        let flags = match self {
            Self::Push(_) => vk::DescriptorSetLayoutCreateFlags::PUSH_DESCRIPTOR_KHR,
            Self::Sets => vk::DescriptorSetLayoutCreateFlags::empty(),
        };
        let info = vk::DescriptorSetLayoutCreateInfo::default().flags(flags).bindings(&bindings);
        // SAFETY: the bindings outlive the call.
        unsafe { device.create_descriptor_set_layout(&info, None) }.during("create set layout")
    }

    /// The template that fills such a layout, as set 0 of a pipeline, from an array of `count` buffers.
    pub fn template(
        &self,
        device: &ash::Device,
        layout: vk::DescriptorSetLayout,
        pipeline_layout: vk::PipelineLayout,
        count: u32,
    ) -> Result<vk::DescriptorUpdateTemplate, Error> {
        let stride = size_of::<vk::DescriptorBufferInfo>();
        let entry = |i: u32| vk::DescriptorUpdateTemplateEntry {
            dst_binding: i,
            dst_array_element: 0,
            descriptor_count: 1,
            descriptor_type: vk::DescriptorType::STORAGE_BUFFER,
            offset: i as usize * stride,
            stride,
        };
        let entries: Vec<_> = (0..count).map(entry).collect();
        let kind = match self {
            Self::Push(_) => vk::DescriptorUpdateTemplateType::PUSH_DESCRIPTORS_KHR,
            Self::Sets => vk::DescriptorUpdateTemplateType::DESCRIPTOR_SET,
        };
        let info = vk::DescriptorUpdateTemplateCreateInfo::default()
            .descriptor_update_entries(&entries)
            .template_type(kind)
            .descriptor_set_layout(layout)
            .pipeline_bind_point(vk::PipelineBindPoint::COMPUTE)
            .pipeline_layout(pipeline_layout);
        // SAFETY: both layouts are alive, and the entries outlive the call.
        unsafe { device.create_descriptor_update_template(&info, None) }.during("create update template")
    }

    /// The descriptor sets of dispatches with these numbers of buffers.
    pub fn room(&self, dispatches: impl Iterator<Item = usize>) -> Room {
        match self {
            Self::Push(_) => Room::default(),
            Self::Sets => dispatches.fold(Room::default(), |room, buffers| Room {
                sets: room.sets + 1,
                buffers: room.buffers + buffers as u32,
            }),
        }
    }

    /// Binds a pipeline's buffers for the next dispatch.
    ///
    /// # Safety
    /// The commands are being recorded; the sets have room; the buffers are alive and match the shader in
    /// number.
    pub unsafe fn bind(
        &self,
        device: &ash::Device,
        (commands, sets): (vk::CommandBuffer, &Sets),
        layouts: &Layouts,
        buffers: &[vk::DescriptorBufferInfo],
    ) -> Result<(), Error> {
        let (layout, data) = (layouts.pipeline, buffers.as_ptr().cast());
        match self {
            // SAFETY: the caller's promise; the template reads as many infos as there are buffers.
            Self::Push(push) => unsafe {
                push.cmd_push_descriptor_set_with_template(commands, layouts.template, layout, 0, data);
            },
            Self::Sets => {
                let wanted = [layouts.set];
                let wanted = vk::DescriptorSetAllocateInfo::default().descriptor_pool(sets.pool).set_layouts(&wanted);
                // SAFETY: as above; the set is new, so that no other dispatch uses it.
                unsafe {
                    let set = device.allocate_descriptor_sets(&wanted).during("allocate descriptor set")?;
                    device.update_descriptor_set_with_template(set[0], layouts.template, data);
                    device.cmd_bind_descriptor_sets(commands, vk::PipelineBindPoint::COMPUTE, layout, 0, &set, &[]);
                }
            }
        }
        Ok(())
    }
}
