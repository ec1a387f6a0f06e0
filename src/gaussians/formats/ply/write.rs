//! Writes the standard layout, binary little-endian, as graphdeco's trainer does.

use std::io::{self, Write};

use super::super::render_mode::ORIGIN;
use super::super::{Gaussians, RenderMode};

/// Rows are assembled in blocks of this many, so that memory stays small beside the model.
const BLOCK: usize = 4096;

/// Writes a whole file; every float keeps its bits, normals are zero as in the reference. `origin` is where the means count
/// from.
pub(in super::super) fn write(
    out: &mut dyn Write,
    model: &Gaussians,
    mode: RenderMode,
    origin: [f64; 3],
) -> io::Result<()> {
    let rest: usize = (1..=model.degree()).map(Gaussians::band_width).sum();
    write_header(out, (model.len(), rest), mode, origin)?;
    let stride = 4 * (17 + rest);
    let mut block = Vec::with_capacity(stride * BLOCK.min(model.len()));
    for i in 0..model.len() {
        let mut push = |value: f32| block.extend_from_slice(&value.to_le_bytes());
        model.means[i].into_iter().for_each(&mut push);
        [0.0; 3].into_iter().for_each(&mut push);
        model.sh[0][3 * i..3 * i + 3].iter().copied().for_each(&mut push);
        above_band_0(model, i).for_each(&mut push);
        push(model.opacity_logits[i]);
        model.log_scales[i].into_iter().for_each(&mut push);
        model.rotations[i].into_iter().for_each(&mut push);
        if block.len() >= stride * BLOCK {
            out.write_all(&block)?;
            block.clear();
        }
    }
    out.write_all(&block)
}

/// The spherical harmonics of Gaussian `i` above band 0: all of red, then those of green and of blue.
pub(super) fn above_band_0(model: &Gaussians, i: usize) -> impl Iterator<Item = f32> {
    (0..3).flat_map(move |channel| {
        model.sh.iter().enumerate().skip(1).flat_map(move |(l, band)| {
            let width = Gaussians::band_width(l);
            band[i * width..(i + 1) * width].iter().skip(channel).step_by(3).copied()
        })
    })
}

/// The lines of every header before its elements.
pub(super) fn begin(out: &mut dyn Write, mode: RenderMode, origin: [f64; 3]) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    if mode.antialiased() {
        writeln!(out, "comment SplatRenderMode: mip")?;
    }
    if origin != [0.0; 3] {
        let [x, y, z] = origin;
        writeln!(out, "comment {ORIGIN} {x} {y} {z}")?;
    }
    Ok(())
}

fn write_header(out: &mut dyn Write, (n, rest): (usize, usize), mode: RenderMode, origin: [f64; 3]) -> io::Result<()> {
    begin(out, mode, origin)?;
    writeln!(out, "element vertex {n}")?;
    for name in ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"] {
        writeln!(out, "property float {name}")?;
    }
    for i in 0..rest {
        writeln!(out, "property float f_rest_{i}")?;
    }
    for name in ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"] {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")
}
