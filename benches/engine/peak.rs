//! Peak rates of a device: bytes copied and float32 operations per second. The times of stages are compared with them.

use qirf_vk::gpu::{Buffer, Device, Groups, Recording, Result};
use qirf_vk::kernels::constants::multiply_add::UNROLLED;
use qirf_vk::kernels::rates::{
    Copy as CopyKernel, CopyPush, CopySpec, MultiplyAdd as Kernel, MultiplyAddPush, MultiplyAddSpec,
};
use qirf_vk::primitives::WORKGROUP;

/// Least number of bytes that a measurement of copying moves, small buffers repeatedly: starting a dispatch is then
/// negligible.
const MOVED: u64 = 64 << 20;
/// Dependent chains per invocation: enough to hide the latency of two units, few enough for the 16 registers of AVX2.
const CHAINS: u32 = 12;

/// Method of copying words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// A kernel, neighbouring lanes taking neighbouring words.
    Kernel,
    /// The device's own copy command.
    Command,
}

/// A copy from one buffer into another.
pub struct Copy {
    from: Buffer<f32>,
    /// Destination of the copy: ones afterwards.
    pub to: Buffer<f32>,
    by: By,
    times: u64,
    /// Invocations per workgroup, and words that each copies.
    shape: [u32; 2],
}

impl Copy {
    /// Two buffers of this many words, each at most the device's largest.
    pub fn new(device: &Device, words: usize, by: By) -> Result<Self> {
        let (from, to) = (device.buffer("rates: from", words)?, device.buffer("rates: to", words)?);
        let mut recording = Recording::new();
        // Pages never written may all map to the same one.
        recording.fill(&from, 1.0_f32.to_bits());
        recording.fill(&to, 0);
        device.run(recording)?;
        let times = MOVED.div_ceil(2 * from.bytes()).max(1);
        let shape = [device.tuning().copy_workgroup, device.tuning().copy_rows];
        Ok(Self { from, to, by, times, shape })
    }

    /// Bytes read and written by one [`Copy::record`].
    pub fn moved(&self) -> u64 {
        self.times * 2 * self.from.bytes()
    }

    /// Records the copy; small ones several times.
    pub fn record(&self, recording: &mut Recording) {
        let count = self.from.len() as u32;
        let [workgroup, rows] = self.shape;
        let kernel = CopyKernel {
            source: &self.from,
            target: &self.to,
            push: CopyPush { count },
            spec: CopySpec { workgroup, rows },
        };
        for _ in 0..self.times {
            match self.by {
                By::Kernel => recording.dispatch(&kernel, Groups::Count(count.div_ceil(workgroup * rows))),
                By::Command => recording.copy(&self.from, &self.to, count as usize),
            }
        }
    }
}

/// Kernels of one workgroup, each waiting for the previous one: the cost of a dispatch without work.
pub struct Chain {
    words: [Buffer<f32>; 2],
    workgroup: u32,
}

impl Chain {
    /// Dispatches of a chain.
    pub const DISPATCHES: u32 = 200;

    /// Two buffers of a workgroup's words.
    pub fn new(device: &Device) -> Result<Self> {
        let workgroup = device.tuning().copy_workgroup;
        let words = || device.zeros("rates: chain", workgroup as usize);
        Ok(Self { words: [words()?, words()?], workgroup })
    }

    /// Records the chain.
    pub fn record(&self, recording: &mut Recording) {
        let [from, to] = &self.words;
        for k in 0..Self::DISPATCHES {
            let (source, target) = if k % 2 == 0 { (from, to) } else { (to, from) };
            let spec = CopySpec { workgroup: self.workgroup, rows: 1 };
            let kernel = CopyKernel { source, target, push: CopyPush { count: self.workgroup }, spec };
            recording.dispatch(&kernel, Groups::Count(1));
        }
    }
}

/// Multiply-adds in registers.
pub struct MultiplyAdd {
    /// The sums, all equal to `CHAINS` once the chains have settled.
    pub sums: Buffer<f32>,
    rounds: u32,
}

impl MultiplyAdd {
    /// Enough work to make its start negligible.
    pub fn new(device: &Device) -> Result<Self> {
        let (groups, rounds) = (device.tuning().multiply_workgroups, device.tuning().multiply_rounds);
        Ok(Self { sums: device.buffer("rates: sums", (groups * WORKGROUP) as usize)?, rounds })
    }

    /// Operations of one [`MultiplyAdd::record`], two per multiply-add.
    pub fn operations(&self) -> u64 {
        self.sums.len() as u64 * u64::from(self.rounds) * u64::from(UNROLLED) * u64::from(CHAINS) * 2
    }

    /// Records the multiply-adds.
    pub fn record(&self, recording: &mut Recording) {
        let kernel = Kernel {
            sums: &self.sums,
            // Towards 1, so that no chain ever holds a number that is slow to compute with.
            push: MultiplyAddPush { rounds: self.rounds, factor: 0.5, term: 0.5 },
            spec: MultiplyAddSpec { workgroup: WORKGROUP, chains: CHAINS },
        };
        recording.dispatch(&kernel, Groups::Count(self.sums.len() as u32 / WORKGROUP));
    }
}
