//! Transforms of prims: the operations that `xformOpOrder` lists, the last of which acts first.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::Fault;

/// The operations of a prim, by name, and their order.
#[derive(Default)]
pub(super) struct Transform {
    pub operations: HashMap<Vec<u8>, Vec<f64>>,
    pub order: Vec<Vec<u8>>,
}

impl Transform {
    /// The map from the prim's coordinates to its parent's.
    pub(super) fn map(&self) -> Result<DAffine3, Fault> {
        let mut map = DAffine3::IDENTITY;
        for name in &self.order {
            let inverse = name.strip_prefix(b"!invert!");
            let own = inverse.unwrap_or(name);
            let operation = self.operations.get(own).and_then(|numbers| operation(own, numbers));
            let Some(operation) = operation.filter(DAffine3::is_finite) else {
                let shown = String::from_utf8_lossy(name);
                return Err(Fault::Unsupported(format!(
                    "a prim has the transform {}, which is not read; apply it in the program that made the file",
                    shown.escape_debug()
                )));
            };
            map *= if inverse.is_some() { operation.inverse() } else { operation };
        }
        Ok(map)
    }
}

/// `xformOp:KIND` or `xformOp:KIND:anything`, with its numbers.
fn operation(name: &[u8], numbers: &[f64]) -> Option<DAffine3> {
    let kind = name.strip_prefix(b"xformOp:")?.split(|b| *b == b':').next()?;
    let turn = |axis: u8, degrees: f64| {
        let axis = [DVec3::X, DVec3::Y, DVec3::Z].get(usize::from(axis.checked_sub(b'X')?)).copied()?;
        Some(DQuat::from_axis_angle(axis, degrees.to_radians()))
    };
    Some(match (kind, numbers) {
        (b"translate", &[x, y, z]) => DAffine3::from_translation(DVec3::new(x, y, z)),
        (b"scale", &[x, y, z]) => DAffine3::from_scale(DVec3::new(x, y, z)),
        (b"orient", &[w, x, y, z]) => {
            let turn = DQuat::from_xyzw(x, y, z, w);
            DAffine3::from_quat(turn * turn.length().recip()) // zero becomes NaN, which is refused
        }
        (b"transform", numbers) => DAffine3::from_mat4(DMat4::from_cols_array(numbers.try_into().ok()?)),
        ([b'r', b'o', b't', b'a', b't', b'e', axes @ ..], numbers) if axes.len() == numbers.len() => {
            // The first axis turns first; numbers are those of x, y and z.
            let degrees = |i: usize, axis: u8| {
                numbers.get(if numbers.len() == 1 { i } else { usize::from(axis.wrapping_sub(b'X')) })
            };
            let turns = axes.iter().enumerate().map(|(i, axis)| turn(*axis, *degrees(i, *axis)?));
            DAffine3::from_quat(turns.collect::<Option<Vec<_>>>()?.into_iter().rev().product())
        }
        _ => return None,
    })
}
