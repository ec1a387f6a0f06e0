//! Devices that the environment hides. Cluster schedulers assign GPUs to jobs by variables that Vulkan ignores.

use crate::gpu::choose::address::{PciAddress, Uuid};
use crate::gpu::info::{DeviceInfo, DeviceKind, Feature};

/// PCI vendors.
const NVIDIA: u32 = 0x10de;
const AMD: u32 = 0x1002;

/// The variables for NVIDIA's GPUs and for AMD's; each indexes the devices that the previous ones leave.
const NVIDIA_VARIABLES: [&str; 1] = ["CUDA_VISIBLE_DEVICES"];
const AMD_VARIABLES: [&str; 2] = ["ROCR_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES"];
/// The job's GPUs on this machine, numbered by Slurm among all of them.
const SLURM: &str = "SLURM_JOB_GPUS";

/// The names by which variables refer to a device.
#[derive(Clone, Debug)]
pub(in crate::gpu) struct Named {
    vendor: u32,
    discrete: bool,
    /// False for a second entry of a GPU, which variables do not count.
    native: bool,
    uuid: Option<Uuid>,
    pci: Option<PciAddress>,
    /// AMD's own number of a GPU, used by `ROCR_VISIBLE_DEVICES`.
    serial: Option<String>,
}

impl Named {
    /// The names of a device; AMD's number is read from the system.
    pub fn of(info: &DeviceInfo) -> Self {
        let file = |pci| format!("/sys/bus/pci/devices/{pci}/unique_id");
        let serial = info.pci.filter(|_| info.vendor == AMD).and_then(|pci| std::fs::read_to_string(file(pci)).ok());
        Self {
            vendor: info.vendor,
            discrete: info.kind == DeviceKind::Discrete,
            native: !info.has(Feature::Direct3D),
            uuid: info.uuid,
            pci: info.pci,
            serial: serial.map(|text| text.trim().to_lowercase()),
        }
    }

    /// Whether an entry such as `GPU-4b2c` means this device. NVIDIA's UUIDs may be abbreviated.
    fn is(&self, entry: &str) -> bool {
        let Some(name) = entry.strip_prefix("GPU-").map(str::to_lowercase).filter(|name| !name.is_empty()) else {
            return false;
        };
        match self.vendor {
            AMD => self.serial.as_ref() == Some(&name),
            _ => self.uuid.is_some_and(|uuid| uuid.to_string().starts_with(&name)),
        }
    }
}

/// Whether a device may be chosen without being named by index or address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gpu) enum Visibility {
    /// The device may be chosen; this is its place among its kind.
    Place(usize),
    /// The device may not be chosen, because this variable hides it.
    Hidden(&'static str),
}

/// The visibility of each device. `variable` returns a variable's text, if it is set.
///
/// Indices count the devices of one vendor by PCI address, as CUDA does if all GPUs are equal or `CUDA_DEVICE_ORDER` is
/// `PCI_BUS_ID`. As in CUDA, an entry that matches no device ends the list.
pub(in crate::gpu) fn visibility(devices: &[Named], variable: &dyn Fn(&str) -> Option<String>) -> Vec<Visibility> {
    let mut all: Vec<Visibility> = (0..devices.len()).map(Visibility::Place).collect();
    let mut set = false;
    for (vendor, variables) in [(NVIDIA, &NVIDIA_VARIABLES[..]), (AMD, &AMD_VARIABLES[..])] {
        let mut left = by_address(devices, |d| d.vendor == vendor);
        for name in variables {
            if let Some(text) = variable(name) {
                left = restrict(&mut all, &left, listed(devices, &left, &text), name);
                set = true;
            }
        }
    }
    if let Some(text) = variable(SLURM).filter(|_| !set) {
        let there = by_address(devices, |d| d.discrete);
        let asked = ranges(&text);
        // A job confined to its devices sees no others that could be hidden, and Slurm's indices count devices that it
        // cannot see.
        if !asked.is_empty() && there.len() > asked.len() {
            let kept = asked.into_iter().map_while(|i| there.get(i).copied()).collect();
            restrict(&mut all, &there, kept, SLURM);
        }
    }
    all
}

/// Positions of the devices of a kind, by PCI address.
fn by_address(devices: &[Named], kind: impl Fn(&Named) -> bool) -> Vec<usize> {
    let mut positions: Vec<usize> = (0..devices.len()).filter(|i| devices[*i].native && kind(&devices[*i])).collect();
    positions.sort_by_key(|i| devices[*i].pci);
    positions
}

/// The devices among `left` that a list of indices and names selects, in the list's order.
fn listed(devices: &[Named], left: &[usize], text: &str) -> Vec<usize> {
    let means = |entry: &str| match entry.trim().parse::<usize>() {
        Ok(index) => left.get(index).copied(),
        Err(_) => left.iter().copied().find(|i| devices[*i].is(entry.trim())),
    };
    let mut kept = Vec::new();
    for device in text.split(',').map_while(means) {
        if !kept.contains(&device) {
            kept.push(device);
        }
    }
    kept
}

/// Hides the devices of `left` that are not in `kept`, and numbers the others; returns `kept`.
fn restrict(all: &mut [Visibility], left: &[usize], kept: Vec<usize>, name: &'static str) -> Vec<usize> {
    if kept.is_empty() && !left.is_empty() {
        tracing::info!("{name} hides all {} devices of its kind", left.len());
    }
    for device in left {
        all[*device] = kept.iter().position(|k| k == device).map_or(Visibility::Hidden(name), Visibility::Place);
    }
    kept
}

/// Indices such as `0,2-3`; empty if the text has another form.
fn ranges(text: &str) -> Vec<usize> {
    let one = |part: &str| {
        let (first, last) = part.trim().split_once('-').unwrap_or((part.trim(), part.trim()));
        // No machine has more; a typo must not exhaust memory.
        let [first, last] = [first, last].map(|n| n.parse::<usize>().ok().filter(|n| *n < 4096));
        Some(first?..=last?)
    };
    text.split(',').map(one).collect::<Option<Vec<_>>>().unwrap_or_default().into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Visibility::{Hidden, Place};

    fn device(vendor: u32, bus: u32) -> Named {
        let pci = PciAddress { domain: 0, bus, device: 0, function: 0 };
        let serial = (vendor == AMD).then(|| format!("{bus:016x}"));
        Named { vendor, discrete: true, native: true, uuid: Some(Uuid([bus as u8; 16])), pci: Some(pci), serial }
    }

    /// Three GPUs by NVIDIA and one by AMD, which Vulkan lists out of order, and a CPU device.
    fn node() -> Vec<Named> {
        let cpu = Named { vendor: 0x10005, discrete: false, native: true, uuid: None, pci: None, serial: None };
        vec![device(NVIDIA, 0x81), device(AMD, 0x21), device(NVIDIA, 0x01), device(NVIDIA, 0xc1), cpu]
    }

    fn seen(devices: &[Named], set: &[(&str, &str)]) -> Vec<Visibility> {
        visibility(devices, &|name| set.iter().find(|(n, _)| *n == name).map(|(_, text)| (*text).to_owned()))
    }

    #[test]
    fn without_variables_vulkans_order_stands() {
        assert_eq!(seen(&node(), &[]), [0, 1, 2, 3, 4].map(Place));
    }

    #[test]
    fn indices_count_one_vendors_devices_by_address() {
        let hidden = Hidden("CUDA_VISIBLE_DEVICES");
        let with = |text: &str| seen(&node(), &[("CUDA_VISIBLE_DEVICES", text)]);
        assert_eq!(with("0"), [hidden, Place(1), Place(0), hidden, Place(4)]);
        assert_eq!(with(" 2, 1"), [Place(1), Place(1), hidden, Place(0), Place(4)]);
        // CUDA: an entry that matches nothing ends the list, as does -1; an empty list shows no device.
        assert_eq!(with("1,7,0"), [Place(0), Place(1), hidden, hidden, Place(4)]);
        for none in ["", "-1", "-1,0", "MIG-1234", "NoDevFiles"] {
            assert_eq!(with(none), [hidden, Place(1), hidden, hidden, Place(4)], "{none}");
        }
        assert_eq!(with("1,1"), with("1"));
    }

    #[test]
    fn second_entries_of_gpus_are_not_counted() {
        let mut devices = vec![Named { native: false, pci: None, ..device(NVIDIA, 0x01) }];
        devices.extend(node());
        let hidden = Hidden("CUDA_VISIBLE_DEVICES");
        let all = seen(&devices, &[("CUDA_VISIBLE_DEVICES", "0")]);
        assert_eq!(all, [Place(0), hidden, Place(2), Place(0), hidden, Place(5)]);
    }

    #[test]
    fn uuids_may_be_cut_short() {
        let hidden = Hidden("CUDA_VISIBLE_DEVICES");
        for text in ["GPU-c1c1c1c1-c1c1-c1c1-c1c1-c1c1c1c1c1c1", "GPU-c1", "GPU-C1C1"] {
            let all = seen(&node(), &[("CUDA_VISIBLE_DEVICES", text)]);
            assert_eq!(all, [hidden, Place(1), hidden, Place(0), Place(4)], "{text}");
        }
        let all = seen(&node(), &[("CUDA_VISIBLE_DEVICES", "GPU-")]);
        assert_eq!(all, [hidden, Place(1), hidden, hidden, Place(4)], "no prefix of all");
    }

    #[test]
    fn hip_indexes_what_rocr_leaves() {
        let devices: Vec<Named> = [0x41, 0x21, 0x31].map(|bus| device(AMD, bus)).into();
        let [rocr, hip] = ["ROCR_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES"];
        assert_eq!(seen(&devices, &[(rocr, "2,1")]), [Place(0), Hidden(rocr), Place(1)]);
        assert_eq!(seen(&devices, &[(rocr, "2,1"), (hip, "1")]), [Hidden(hip), Hidden(rocr), Place(0)]);
        assert_eq!(seen(&devices, &[(hip, "0")]), [Hidden(hip), Place(0), Hidden(hip)]);
        let by_number = seen(&devices, &[(rocr, "GPU-0000000000000041")]);
        assert_eq!(by_number, [Place(0), Hidden(rocr), Hidden(rocr)]);
        assert_eq!(seen(&devices, &[(rocr, "GPU-00")]), [Hidden(rocr); 3], "AMD's numbers are whole");
    }

    #[test]
    fn slurms_indices_count_only_where_nothing_else_is_told() {
        let slurm = Hidden("SLURM_JOB_GPUS");
        // By address: 01 (2), 21 (1), 81 (0), c1 (3).
        assert_eq!(seen(&node(), &[("SLURM_JOB_GPUS", "1,3")]), [slurm, Place(0), slurm, Place(1), Place(4)]);
        assert_eq!(seen(&node(), &[("SLURM_JOB_GPUS", "2-3")]), [Place(0), slurm, slurm, Place(1), Place(4)]);
        // A job confined to its devices sees no others.
        assert_eq!(seen(&node(), &[("SLURM_JOB_GPUS", "4-7")]), [0, 1, 2, 3, 4].map(Place));
        let both = seen(&node(), &[("SLURM_JOB_GPUS", "3"), ("CUDA_VISIBLE_DEVICES", "0")]);
        assert_eq!(both, seen(&node(), &[("CUDA_VISIBLE_DEVICES", "0")]));
        assert_eq!(seen(&node(), &[("SLURM_JOB_GPUS", "0-99999999999")]), [0, 1, 2, 3, 4].map(Place), "no list");
    }
}
