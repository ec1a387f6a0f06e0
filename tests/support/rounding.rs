//! The program's shaders as on a device whose exponentials, logarithms, roots, sines and quotients are less exact: each
//! is off by up to 2^-23 of its value, which is one to two units in the last place.

const HEADER: usize = 5;
/// Word of the header: one more than the largest id.
const BOUND: usize = 3;
const EXT_INST: u32 = 12;
const TYPE_INT: u32 = 21;
const TYPE_FLOAT: u32 = 22;
const TYPE_VECTOR: u32 = 23;
const CONSTANT: u32 = 43;
const CONSTANT_COMPOSITE: u32 = 44;
const FUNCTION: u32 = 54;
const CONVERT_U_TO_F: u32 = 112;
const BITCAST: u32 = 124;
const F_ADD: u32 = 129;
const I_MUL: u32 = 132;
const F_MUL: u32 = 133;
const F_DIV: u32 = 136;
const U_MOD: u32 = 137;
const SHIFT_RIGHT: u32 = 194;
/// Instructions of GLSL.std.450: sine and cosine, exp, log, exp2, log2, sqrt, inversesqrt.
const INEXACT: [u32; 8] = [13, 14, 27, 28, 29, 30, 31, 32];

/// A float type, and the constants for errors of its values.
struct Kind {
    float: u32,
    words: u32,
    /// Knuth's multiplier, 16 and 5 as words; 2^-24 and 1 - 2^-23 as floats.
    constants: [u32; 5],
}

struct Module {
    out: Vec<u32>,
    bound: u32,
}

impl Module {
    fn push(&mut self, operation: u32, operands: &[u32]) {
        self.out.push(operation | (operands.len() as u32 + 1) << 16);
        self.out.extend(operands);
    }

    fn id(&mut self) -> u32 {
        self.bound += 1;
        self.bound - 1
    }

    /// Appends an instruction with a result; returns the result's id.
    fn made(&mut self, operation: u32, kind: u32, operands: &[u32]) -> u32 {
        let id = self.id();
        self.push(operation, &[&[kind, id], operands].concat());
        id
    }

    /// Declares the constants of each float type, and the types of words that are missing.
    fn kinds(&mut self, types: &[Vec<u32>]) -> Vec<Kind> {
        let find = |wanted: &[u32]| types.iter().find(|t| t[0] == wanted[0] && t[2..] == wanted[1..]).map(|t| t[1]);
        let Some(float) = find(&[TYPE_FLOAT, 32]) else { return Vec::new() };
        let word = find(&[TYPE_INT, 32, 0]).unwrap_or_else(|| {
            let id = self.id();
            self.push(TYPE_INT, &[id, 32, 0]);
            id
        });
        let values = [0x9e37_79b1, 16, 5, 2_f32.powi(-24).to_bits(), (1.0 - 2_f32.powi(-23)).to_bits()];
        let of = [word, word, word, float, float];
        let scalars: Vec<u32> =
            of.iter().zip(values).map(|(kind, value)| self.made(CONSTANT, *kind, &[value])).collect();
        let mut kinds = vec![Kind { float, words: word, constants: scalars.clone().try_into().unwrap() }];
        for n in 2..=4 {
            let Some(vector) = find(&[TYPE_VECTOR, float, n]) else { continue };
            let words = find(&[TYPE_VECTOR, word, n]).unwrap_or_else(|| {
                let id = self.id();
                self.push(TYPE_VECTOR, &[id, word, n]);
                id
            });
            let of = [words, words, words, vector, vector];
            let alike = |scalar: u32| vec![scalar; n as usize];
            let constants: Vec<u32> =
                of.iter().zip(&scalars).map(|(kind, s)| self.made(CONSTANT_COMPOSITE, *kind, &alike(*s))).collect();
            kinds.push(Kind { float: vector, words, constants: constants.try_into().unwrap() });
        }
        kinds
    }

    /// `result`: the exact value with an error chosen by the bits of `operand`.
    fn off(&mut self, kind: &Kind, result: u32, exact: u32, operand: u32) {
        let [multiplier, sixteen, five, step, least] = kind.constants;
        let bits = self.made(BITCAST, kind.words, &[operand]);
        let mixed = self.made(I_MUL, kind.words, &[bits, multiplier]);
        let high = self.made(SHIFT_RIGHT, kind.words, &[mixed, sixteen]);
        let choice = self.made(U_MOD, kind.words, &[high, five]);
        let steps = self.made(CONVERT_U_TO_F, kind.float, &[choice]);
        let error = self.made(F_MUL, kind.float, &[steps, step]);
        let factor = self.made(F_ADD, kind.float, &[error, least]);
        self.push(F_MUL, &[kind.float, result, exact, factor]);
    }
}

/// Rewrites a module; adds to the number of results made less exact.
pub fn rewrite(words: &[u32], changed: &mut usize) -> Vec<u32> {
    let mut module = Module { out: words[..HEADER].to_vec(), bound: words[BOUND] };
    let (mut types, mut kinds) = (Vec::new(), Vec::new());
    let mut at = HEADER;
    while at < words.len() {
        let length = (words[at] >> 16) as usize;
        let (operation, operands) = (words[at] & 0xffff, &words[at + 1..at + length]);
        match operation {
            TYPE_INT | TYPE_FLOAT | TYPE_VECTOR => types.push([&[operation], operands].concat()),
            FUNCTION if kinds.is_empty() => kinds = module.kinds(&types),
            _ => {}
        }
        let operand = match (operation, operands) {
            (F_DIV, &[_, _, above, _]) => Some(above),
            (EXT_INST, &[_, _, _, function, x]) if INEXACT.contains(&function) => Some(x),
            _ => None,
        };
        let kind = kinds.iter().find(|kind| operands.first() == Some(&kind.float));
        if let (Some(operand), Some(kind)) = (operand, kind) {
            *changed += 1;
            let exact = module.id();
            module.push(operation, &[&[operands[0], exact], &operands[2..]].concat());
            module.off(kind, operands[1], exact, operand);
        } else {
            module.out.extend(&words[at..at + length]);
        }
        at += length;
    }
    module.out[BOUND] = module.bound;
    module.out
}
