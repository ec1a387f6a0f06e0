//! The choice among the devices of this machine.

pub(in crate::gpu) mod address;
pub(in crate::gpu) mod lease;
pub(in crate::gpu) mod properties;
pub(in crate::gpu) mod select;
pub(in crate::gpu) mod visible;

use self::address::{PciAddress, Uuid};
use self::lease::Lease;
use self::properties::Candidate;
use crate::gpu::error::Error;
use crate::gpu::info::{DeviceInfo, DeviceKind, Feature};
use std::path::Path;

/// The device that the user asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Wish {
    /// The best one.
    Best,
    /// The best one that no other process holds by a lease.
    Free,
    /// The one with this UUID.
    Uuid(Uuid),
    /// The one at this PCI address.
    Pci(PciAddress),
    /// The one of this index, if it is a number; otherwise one whose name contains the text.
    Text(String),
}

impl Wish {
    fn parse(wanted: Option<&str>) -> Result<Self, Error> {
        let Some(text) = wanted else { return Ok(Self::Best) };
        let parsed = match text.split_once(':') {
            Some(("uuid", uuid)) => uuid.parse().map(Self::Uuid),
            Some(("pci", address)) => address.parse().map(Self::Pci),
            _ if text == "free" => Ok(Self::Free),
            _ if text.is_empty() => Ok(Self::Best),
            _ => Ok(Self::Text(text.to_owned())),
        };
        parsed.map_err(Error::Address)
    }
}

/// Chooses the device that `wanted` names: an index, part of a name in any case, `uuid:UUID`, `pci:ADDRESS`, or `free`,
/// for one that comes with its lease. Without `wanted`, chooses the best usable one: discrete before integrated before
/// virtual before CPU.
///
/// Devices that the environment hides can be chosen by index or address only.
pub(in crate::gpu) fn choose(mut all: Vec<Candidate>, wanted: Option<&str>, leases: &Path) -> Result<Candidate, Error> {
    let wish = Wish::parse(wanted)?;
    let seen: Vec<(&DeviceInfo, usize)> = all.iter().map(|c| (&c.info, c.place)).collect();
    let (position, lease) = match &wish {
        Wish::Free => free(&seen, leases)?,
        _ => (position(&seen, &wish).ok_or_else(|| unknown(&seen, wanted))?, None),
    };
    let chosen = Candidate { lease, ..all.swap_remove(position) };
    match &chosen.info.missing {
        Some(feature) => Err(Error::MissingFeature { device: chosen.info.name.clone(), feature: feature.clone() }),
        None => Ok(chosen),
    }
}

/// The position of the requested device among devices with their places.
fn position(all: &[(&DeviceInfo, usize)], wish: &Wish) -> Option<usize> {
    match wish {
        Wish::Best | Wish::Free => ranked(all).first().copied(),
        Wish::Uuid(uuid) => all.iter().position(|(d, _)| d.uuid == Some(*uuid)),
        Wish::Pci(address) => all.iter().position(|(d, _)| d.pci == Some(*address)),
        Wish::Text(text) => {
            let lower = text.to_lowercase();
            let named = |i: &usize| all[*i].0.name.to_lowercase().contains(&lower);
            let mut visible: Vec<usize> = (0..all.len()).filter(|i| all[*i].0.hidden_by.is_none()).collect();
            visible.sort_by_key(|i| all[*i].1);
            match text.parse::<usize>() {
                Ok(index) => Some(index).filter(|i| *i < all.len()),
                Err(_) => visible.into_iter().find(named),
            }
        }
    }
}

/// The rank of a device: the smaller, the better.
fn rank(device: &DeviceInfo) -> (bool, DeviceKind, bool) {
    (device.missing.is_some(), device.kind, device.has(Feature::Direct3D))
}

/// Positions of the visible devices, the best first.
fn ranked(all: &[(&DeviceInfo, usize)]) -> Vec<usize> {
    let mut visible: Vec<usize> = (0..all.len()).filter(|i| all[*i].0.hidden_by.is_none()).collect();
    visible.sort_by_key(|i| (rank(all[*i].0), all[*i].1));
    visible
}

/// The first device of the best kind whose lease no other process holds. A worse kind is no substitute: its results
/// differ in their bits, and it is a hundred times slower.
fn free(all: &[(&DeviceInfo, usize)], leases: &Path) -> Result<(usize, Option<Lease>), Error> {
    let ranked = ranked(all);
    let best = all[*ranked.first().ok_or_else(|| unknown(all, None))?].0;
    let equal = |i: &usize| rank(all[*i].0) == rank(best);
    let machine = lease::machine();
    let mut held = 0;
    for position in ranked.into_iter().filter(equal) {
        let lease = Lease::take(leases, &lease::name(all[position].0, &machine));
        match lease.map_err(|source| Error::Lease { path: leases.to_owned(), source })? {
            Some(lease) => return Ok((position, Some(lease))),
            None => held += 1,
        }
    }
    Err(Error::NoFreeDevice { held, kind: best.kind })
}

/// The error for a request that no device satisfies.
fn unknown(all: &[(&DeviceInfo, usize)], wanted: Option<&str>) -> Error {
    let hidden = all.iter().find_map(|(d, _)| d.hidden_by);
    match (wanted, hidden) {
        (None | Some("free"), None) => Error::NoDevice,
        (None | Some("free"), Some(variable)) => Error::HiddenDevices { variable },
        (Some(wanted), _) => {
            let told = |d: &DeviceInfo| match d.hidden_by {
                Some(variable) => format!("{} {} (hidden by {variable})", d.index, d.name),
                None => format!("{} {}", d.index, d.name),
            };
            let there = all.iter().map(|(d, _)| told(d)).collect::<Vec<_>>().join(", ");
            Error::UnknownDevice { wanted: wanted.to_owned(), there }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::properties::Report;
    use super::*;

    fn device(index: usize, name: &str, kind: DeviceKind) -> DeviceInfo {
        DeviceInfo {
            name: name.into(),
            kind,
            uuid: Some(Uuid([index as u8; 16])),
            pci: Some(PciAddress { domain: 0, bus: 0x10 * (index as u32 + 1), device: 0, function: 0 }),
            ..Report::default().info(index)
        }
    }

    /// A CPU device and three equal GPUs; the first GPU is hidden, and the last comes before the other.
    fn node() -> Vec<(DeviceInfo, usize)> {
        let gpu = |i| device(i, "H200", DeviceKind::Discrete);
        let hidden = DeviceInfo { hidden_by: Some("CUDA_VISIBLE_DEVICES"), ..gpu(1) };
        vec![(device(0, "llvmpipe", DeviceKind::Cpu), 0), (hidden, 0), (gpu(2), 1), (gpu(3), 0)]
    }

    fn chosen(all: &[(DeviceInfo, usize)], wanted: Option<&str>) -> Option<usize> {
        let all: Vec<_> = all.iter().map(|(d, place)| (d, *place)).collect();
        position(&all, &Wish::parse(wanted).unwrap())
    }

    #[test]
    fn names_take_visible_devices_and_addresses_take_any() {
        let all = node();
        for (wanted, expected) in [
            (None, Some(3)),
            (Some("h2"), Some(3)),
            (Some("LLVM"), Some(0)),
            (Some("1"), Some(1)),
            (Some("4"), None),
            (Some("200"), None),
            (Some(""), Some(3)),
            (Some("uuid:GPU-01010101-0101-0101-0101-010101010101"), Some(1)),
            (Some("uuid:09010101010101010101010101010101"), None),
            (Some("pci:30:00.0"), Some(2)),
            (Some("pci:31:00.0"), None),
        ] {
            assert_eq!(chosen(&all, wanted), expected, "{wanted:?}");
        }
        for wrong in ["uuid:1", "pci:0", "pci:"] {
            assert!(matches!(Wish::parse(Some(wrong)), Err(Error::Address(_))), "{wrong}");
        }
    }

    /// On Windows a GPU has two entries where Direct3D is offered as Vulkan, and that one may come first.
    #[test]
    fn a_gpus_own_driver_comes_before_direct3d() {
        let mut all = node();
        all[3].0.optional.push(Feature::Direct3D);
        assert_eq!(chosen(&all, None), Some(2));
        assert_eq!(chosen(&all, Some("3")), Some(3), "it can be named");
        let alone = [all[0].clone(), all[3].clone()];
        assert_eq!(chosen(&alone, None), Some(1), "and is used where there is no other GPU");
        let folder = tempfile::tempdir().unwrap();
        let all: Vec<_> = all.iter().map(|(d, place)| (d, *place)).collect();
        let held = free(&all, folder.path()).unwrap();
        assert_eq!(held.0, 2);
        assert!(matches!(free(&all, folder.path()), Err(Error::NoFreeDevice { held: 1, .. })), "one GPU, one lease");
    }

    #[test]
    fn free_devices_are_of_the_best_kind_and_have_one_holder() {
        let folder = tempfile::tempdir().unwrap();
        let all = node();
        let all: Vec<_> = all.iter().map(|(d, place)| (d, *place)).collect();
        let take = || free(&all, folder.path());
        let (first, second) = (take().unwrap(), take().unwrap());
        assert_eq!((first.0, second.0), (3, 2));
        let third = take().map(|(position, _)| position);
        assert!(matches!(third, Err(Error::NoFreeDevice { held: 2, kind: DeviceKind::Discrete })), "{third:?}");
        drop(second);
        assert_eq!(take().unwrap().0, 2, "it is free again");
        drop(first);
    }

    #[test]
    fn hidden_devices_are_told_of() {
        let all = node();
        let hidden = [(&all[1].0, 0)];
        assert!(matches!(unknown(&hidden, None), Error::HiddenDevices { variable: "CUDA_VISIBLE_DEVICES" }));
        let told = unknown(&hidden, Some("riva")).to_string();
        assert!(told.contains("1 H200 (hidden by CUDA_VISIBLE_DEVICES)"), "{told}");
        assert!(matches!(unknown(&[], Some("free")), Error::NoDevice));
    }
}
