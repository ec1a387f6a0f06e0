//! The program's shaders, as compiled by a driver that assumes that no float is NaN or infinite. Vulkan allows that
//! assumption unless a module forbids it and the device can keep NaN.

use super::mutants::rewritten;
use qirf_vk::gpu::{Device, DeviceClass, DeviceOptions, TuningChoice};
use std::path::Path;
use tempfile::TempDir;

/// Words of a module's header.
const HEADER: usize = 5;
const EXT_INST: u32 = 12;
const IS_NAN: u32 = 156;
const IS_INF: u32 = 157;
const LOGICAL_NOT: u32 = 168;
/// The first comparison. They come in pairs: the ordered form, false if an operand is NaN, then the unordered form,
/// true in that case.
const F_ORD_EQUAL: u32 = 180;
const F_ORD_NOT_EQUAL: u32 = 182;
const F_UNORD_GREATER_THAN_EQUAL: u32 = 191;
/// By pair: the comparison that is true where this one is false, if there is no NaN. Equal, not equal, less, greater,
/// less or equal, greater or equal.
const OPPOSITE: [u32; 6] = [1, 0, 5, 4, 3, 2];
/// Instructions of GLSL.std.450 whose result is undefined if an operand is NaN.
const F_MIN: u32 = 37;
const F_MAX: u32 = 40;
const F_CLAMP: u32 = 43;
/// The same instruction with a defined result: the operand that is a number.
const N_MIN: u32 = 79;
const N_MAX: u32 = 80;
const N_CLAMP: u32 = 81;

/// Results that such a driver gives for comparisons with NaN, `a < b` and `!(a < b)`. The program's own modules give
/// false and true. Both as true would change only the first, which the first outcome does, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// True, and therefore false.
    Unordered,
    /// False; and `a >= b` is false as well.
    BothFalse,
}

impl Outcome {
    fn ordered(self) -> bool {
        self == Self::BothFalse
    }
}

/// Number of instructions that [`rewrite`] changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changed {
    pub tests: usize,
    pub comparisons: usize,
    pub extremes: usize,
}

/// Rewrites a module: NaN and infinity are never found, comparisons have the given outcome, and minima, maxima and
/// clamps take the other operand if one is NaN.
pub fn rewrite(words: &[u32], outcome: Outcome, changed: &mut Changed) -> Vec<u32> {
    let mut out = words[..HEADER].to_vec();
    let mut comparisons: Vec<(u32, [u32; 3])> = Vec::new(); // result; pair, operands
    let form = |pair: u32| F_ORD_EQUAL + 2 * pair + u32::from(!outcome.ordered());
    let mut at = HEADER;
    while at < words.len() {
        let length = (words[at] >> 16) as usize;
        let mut instruction = words[at..at + length].to_vec();
        match (words[at] & 0xffff, &words[at + 1..at + length]) {
            (IS_NAN | IS_INF, &[kind, result, x]) => {
                changed.tests += 1;
                // No number differs from itself, and for NaN the ordered form is false.
                instruction = vec![F_ORD_NOT_EQUAL | 5 << 16, kind, result, x, x];
            }
            (operation @ F_ORD_EQUAL..=F_UNORD_GREATER_THAN_EQUAL, &[_, result, a, b]) => {
                changed.comparisons += 1;
                let pair = (operation - F_ORD_EQUAL) / 2;
                comparisons.push((result, [pair, a, b]));
                instruction[0] = form(pair) | 5 << 16;
            }
            (LOGICAL_NOT, &[kind, result, condition]) if outcome != Outcome::Unordered => {
                if let Some((_, [pair, a, b])) = comparisons.iter().find(|(id, _)| *id == condition) {
                    instruction = vec![form(OPPOSITE[*pair as usize]) | 5 << 16, kind, result, *a, *b];
                }
            }
            (EXT_INST, &[_, _, _, operation @ (F_MIN | F_MAX | F_CLAMP), ..]) => {
                changed.extremes += 1;
                match (outcome, operation) {
                    (Outcome::Unordered, F_MIN) => instruction[4] = N_MIN,
                    (Outcome::Unordered, F_MAX) => instruction[4] = N_MAX,
                    (Outcome::Unordered, _) => instruction[4] = N_CLAMP,
                    (_, F_MIN | F_MAX) => instruction.swap(5, 6),
                    _ => {}
                }
            }
            _ => {}
        }
        out.extend(instruction);
        at += length;
    }
    out
}

/// A device as tuned for GPUs, with the modules of this folder, rewritten; they must exist as long as it creates pipelines.
pub fn device(modules: &Path, outcome: Outcome) -> (Device, TempDir, Changed) {
    let mut changed = Changed::default();
    let tuned = |options: &mut DeviceOptions| options.tuning = Some(TuningChoice::class(DeviceClass::Gpu));
    let (device, folder) = rewritten(modules, tuned, |words| rewrite(words, outcome, &mut changed));
    (device, folder, changed)
}
