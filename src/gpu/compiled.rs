//! Statistics of compiled kernels: registers, spills, code size, as far as the driver reports them
//! (`VK_KHR_pipeline_executable_properties`).

use super::error::{During, Error};
use ash::{khr, vk};
use serde::Serialize;

/// One kernel, as compiled.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compiled {
    /// `room/stage`.
    pub kernel: &'static str,
    /// Values of its specialization constants, as bits.
    pub constants: Vec<u32>,
    /// Subgroup size of the compiled code.
    pub subgroup: u32,
    /// The driver's statistics, under its names and in its order.
    pub statistics: Vec<(String, f64)>,
}

impl Compiled {
    /// Queries the driver, if it can tell, about the pipeline of a kernel, created for this purpose.
    pub(super) fn of(
        driver: Option<&khr::pipeline_executable_properties::Device>,
        (kernel, constants): (&'static str, &[u32]),
        pipeline: vk::Pipeline,
    ) -> Result<Self, Error> {
        let mut compiled = Self { kernel, constants: constants.to_vec(), subgroup: 0, statistics: Vec::new() };
        let Some(executables) = driver else { return Ok(compiled) };
        let info = vk::PipelineInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline is alive, and was made with the flag that captures statistics.
        let properties = unsafe { executables.get_pipeline_executable_properties(&info) };
        for (index, executable) in properties.during("read pipeline executables")?.iter().enumerate() {
            compiled.subgroup = executable.subgroup_size;
            let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline).executable_index(index as u32);
            // SAFETY: as above, of one of its executables.
            let statistics = unsafe { executables.get_pipeline_executable_statistics(&info) };
            compiled
                .statistics
                .extend(statistics.during("read pipeline statistics")?.iter().map(|s| (name(s), value(s))));
        }
        Ok(compiled)
    }
}

fn name(statistic: &vk::PipelineExecutableStatisticKHR<'_>) -> String {
    statistic.name_as_c_str().unwrap_or(c"").to_string_lossy().into_owned()
}

fn value(statistic: &vk::PipelineExecutableStatisticKHR<'_>) -> f64 {
    let value = &statistic.value;
    // SAFETY: the format tells which field of the union the driver wrote.
    unsafe {
        match statistic.format {
            vk::PipelineExecutableStatisticFormatKHR::BOOL32 => f64::from(value.b32),
            vk::PipelineExecutableStatisticFormatKHR::INT64 => value.i64 as f64,
            vk::PipelineExecutableStatisticFormatKHR::UINT64 => value.u64 as f64,
            _ => value.f64,
        }
    }
}
