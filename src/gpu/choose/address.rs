//! Addresses of devices outside Vulkan: by UUID, and by location on the PCI bus.

use serde::{Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// A device's UUID. On NVIDIA's GPUs it is the one that CUDA and `nvidia-smi` print after `GPU-`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Uuid(pub [u8; 16]);

impl fmt::Display for Uuid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, byte) in self.0.iter().enumerate() {
            write!(f, "{}{byte:02x}", if [4, 6, 8, 10].contains(&i) { "-" } else { "" })?;
        }
        Ok(())
    }
}

impl FromStr for Uuid {
    type Err = String;

    /// 32 hexadecimal digits, with or without hyphens and a leading `GPU-`.
    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.strip_prefix("GPU-").unwrap_or(text).replace('-', "");
        let whole = digits.len() == 32 && digits.bytes().all(|b| b.is_ascii_hexdigit());
        let number = u128::from_str_radix(&digits, 16).ok().filter(|_| whole);
        number.map(|n| Self(n.to_be_bytes())).ok_or_else(|| format!("'{text}' is not a UUID of 32 hexadecimal digits"))
    }
}

/// A location on the PCI bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PciAddress {
    /// Domain.
    pub domain: u32,
    /// Bus.
    pub bus: u32,
    /// Device.
    pub device: u32,
    /// Function.
    pub function: u32,
}

impl fmt::Display for PciAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:02x}:{:02x}.{:x}", self.domain, self.bus, self.device, self.function)
    }
}

impl FromStr for PciAddress {
    type Err = String;

    /// Reads an address as `lspci` and `nvidia-smi` write it, in hexadecimal digits: `81:00.0`, `0000:81:00.0` or
    /// `00000000:81:00.0`.
    fn from_str(text: &str) -> Result<Self, String> {
        let hex = |digits: &str, most: u32| {
            let plain = digits.bytes().all(|b| b.is_ascii_hexdigit());
            u32::from_str_radix(digits, 16).ok().filter(|n| plain && *n <= most)
        };
        let parse = || {
            let (place, function) = text.rsplit_once('.')?;
            let (rest, device) = place.rsplit_once(':')?;
            let (domain, bus) = rest.rsplit_once(':').unwrap_or(("0", rest));
            Some(Self {
                domain: hex(domain, u32::MAX)?,
                bus: hex(bus, 0xff)?,
                device: hex(device, 0x1f)?,
                function: hex(function, 7)?,
            })
        };
        parse().ok_or_else(|| format!("'{text}' is not a PCI address such as 0000:81:00.0"))
    }
}

/// Serialises as the text that is printed.
macro_rules! as_text {
    ($($address:ty),*) => { $(
        impl Serialize for $address {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }
    )* };
}

as_text!(Uuid, PciAddress);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_tools_write_them() {
        let pci = PciAddress { domain: 0, bus: 0x81, device: 0x1f, function: 7 };
        for text in ["81:1f.7", "0000:81:1f.7", "00000000:81:1F.7"] {
            assert_eq!(text.parse(), Ok(pci), "{text}");
        }
        assert_eq!(pci.to_string(), "0000:81:1f.7");
        let far = PciAddress { domain: 0x10002, ..pci };
        assert_eq!(far.to_string().parse(), Ok(far));
        for text in ["", "81", "81:00", "100:00.0", "81:20.0", "81:00.8", "+1:00.0", "81:00.0 "] {
            assert!(text.parse::<PciAddress>().is_err_and(|e| e.contains(&format!("'{text}'"))), "{text}");
        }
    }

    #[test]
    fn uuids_are_read_as_tools_write_them() {
        let uuid = Uuid(std::array::from_fn(|i| (0x11 * i) as u8));
        assert_eq!(uuid.to_string(), "00112233-4455-6677-8899-aabbccddeeff");
        for text in ["GPU-00112233-4455-6677-8899-aabbccddeeff", "00112233445566778899AABBCCDDEEFF"] {
            assert_eq!(text.parse(), Ok(uuid), "{text}");
        }
        for text in ["", "GPU-", "0011", "+0112233445566778899aabbccddeeff", "0g112233445566778899aabbccddeeff"] {
            assert!(text.parse::<Uuid>().is_err(), "{text}");
        }
    }
}
