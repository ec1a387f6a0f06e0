//! Little-endian fields and the quantities that several formats store alike.

/// The zeroth real spherical harmonic, 1 / (2 sqrt(pi)), to the eight digits that other programs use for these formats:
/// one float below the shaders' `SH_C0`.
pub(super) const SH_C0: f32 = 0.282_094_79;

/// The `N` bytes at `offset`, or `None` past the end.
pub(super) fn field<const N: usize>(bytes: &[u8], offset: usize) -> Option<[u8; N]> {
    bytes.get(offset..offset.checked_add(N)?)?.try_into().ok()
}

/// The little-endian u16 at `offset`.
pub(super) fn u16_at(bytes: &[u8], offset: usize) -> Option<u16> {
    field(bytes, offset).map(u16::from_le_bytes)
}

/// The little-endian u32 at `offset`.
pub(super) fn u32_at(bytes: &[u8], offset: usize) -> Option<u32> {
    field(bytes, offset).map(u32::from_le_bytes)
}

/// The little-endian u64 at `offset`.
pub(super) fn u64_at(bytes: &[u8], offset: usize) -> Option<u64> {
    field(bytes, offset).map(u64::from_le_bytes)
}

/// The little-endian f32 at `offset`.
pub(super) fn f32_at(bytes: &[u8], offset: usize) -> Option<f32> {
    field(bytes, offset).map(f32::from_le_bytes)
}

/// The logit of an 8-bit opacity; 0 and 255 give infinities, which the common repairs clamp and count.
pub(super) fn logit_of_byte(alpha: u8) -> f32 {
    (f32::from(alpha) / f32::from(255 - alpha)).ln()
}

/// The zeroth SH coefficient of a colour in [0, 1].
pub(super) fn sh0_of_colour(colour: f32) -> f32 {
    (colour - 0.5) / SH_C0
}

/// A quaternion from its three smaller components in order and the index of the greatest, which is taken positive.
pub(super) fn from_smallest_three(smaller: [f32; 3], greatest: usize) -> [f32; 4] {
    let mut q = [0.0; 4];
    let mut rest = smaller.into_iter();
    for (i, component) in q.iter_mut().enumerate() {
        if i != greatest {
            *component = rest.next().unwrap_or(0.0);
        }
    }
    // Quantised components of a damaged file may exceed unit length.
    q[greatest & 3] = (1.0 - smaller.iter().map(|x| x * x).sum::<f32>()).max(0.0).sqrt();
    q
}

/// The inverse: the three smaller components of a normalised quaternion whose greatest component is positive, and the
/// index of that one. A zero quaternion becomes the identity, whose real part has the index `real`.
pub(super) fn to_smallest_three(q: [f32; 4], real: usize) -> ([f64; 3], usize) {
    let q = q.map(f64::from);
    let greatest = (0..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length == 0.0 || !length.is_finite() {
        return ([0.0; 3], real);
    }
    let mut smaller = [0.0; 3];
    let rest = q.iter().enumerate().filter(|(i, _)| *i != greatest);
    for (out, (_, component)) in smaller.iter_mut().zip(rest) {
        *out = component / length * q[greatest].signum();
    }
    (smaller, greatest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smallest_three_is_unit_and_in_order() {
        assert_eq!(from_smallest_three([0.0, 0.6, 0.0], 0), [0.8, 0.0, 0.6, 0.0]);
        assert_eq!(from_smallest_three([0.1, 0.2, 0.3], 3)[..3], [0.1, 0.2, 0.3]);
        assert!(from_smallest_three([0.7, 0.7, 0.7], 1)[1] == 0.0);
    }

    #[test]
    fn opacity_bytes() {
        assert_eq!(logit_of_byte(0), f32::NEG_INFINITY);
        assert_eq!(logit_of_byte(255), f32::INFINITY);
        assert!((logit_of_byte(204) - 4f32.ln()).abs() < 1e-6);
    }
}
