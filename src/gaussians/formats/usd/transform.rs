//! Transforms of prims: the operations that `xformOpOrder` lists, the last of which acts first.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::Fault;

/// In an order: the prim does not move with those around it.
const RESET: &[u8] = b"!resetXformStack!";

/// The operations of a prim, by name, and their order.
#[derive(Default)]
pub(super) struct Transform {
    pub operations: HashMap<Vec<u8>, Vec<f64>>,
    pub order: Vec<Vec<u8>>,
}

impl Transform {
    /// Notes an operation without a value.
    pub(super) fn declare(&mut self, name: &[u8]) {
        self.operations.entry(name.to_owned()).or_default();
    }

    /// Notes an operation with time samples, which are not read: without a default value it is refused.
    pub(super) fn sample(&mut self, name: &[u8]) {
        let numbers = self.operations.entry(name.to_owned()).or_default();
        if numbers.is_empty() {
            numbers.push(f64::NAN);
        }
    }

    /// True if the maps of the prims around do not apply.
    pub(super) fn resets(&self) -> bool {
        self.order.iter().any(|name| name == RESET)
    }

    /// The map from the prim's coordinates to its parent's, or to the layer's if it resets.
    pub(super) fn map(&self) -> Result<DAffine3, Fault> {
        let mut map = DAffine3::IDENTITY;
        // Operations before the last reset do not count either.
        let start = self.order.iter().rposition(|name| name == RESET).map_or(0, |at| at + 1);
        for name in &self.order[start..] {
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
    let axis = |letter: u8| [DVec3::X, DVec3::Y, DVec3::Z].get(usize::from(letter.checked_sub(b'X')?)).copied();
    let turn = |letter: u8, degrees: f64| Some(DQuat::from_axis_angle(axis(letter)?, degrees.to_radians()));
    Some(match (kind, numbers) {
        // By the schema, an operation without a value does nothing.
        (_, []) => DAffine3::IDENTITY,
        ([b't', b'r', b'a', b'n', b's', b'l', b'a', b't', b'e', letter], &[by]) => {
            DAffine3::from_translation(axis(*letter)? * by)
        }
        ([b's', b'c', b'a', b'l', b'e', letter], &[by]) => {
            let axis = axis(*letter)?;
            DAffine3::from_scale(DVec3::ONE - axis + axis * by)
        }
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
