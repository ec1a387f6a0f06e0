//! A photo at half its size: the mean of each square of four pixels.

/// Halves `photo` (RGBA, 8 bits each, red lowest; `width` x `height`, row by row). Colours are weighted by their alpha,
/// or equally if the whole square is transparent; everything is rounded half up. An odd last row or column is left out.
///
/// # Panics
/// If `photo` has fewer than `width` x `height` pixels.
pub fn halve(photo: &[u32], [width, height]: [u32; 2]) -> Vec<u32> {
    let square = |x: u32, y: u32| {
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| photo[((2 * y + j) * width + 2 * x + i) as usize])
    };
    (0..height / 2).flat_map(|y| (0..width / 2).map(move |x| (x, y))).map(|(x, y)| mean(square(x, y))).collect()
}

fn mean(square: [u32; 4]) -> u32 {
    let bytes = square.map(u32::to_le_bytes).map(|b| b.map(f64::from));
    let alpha: f64 = bytes.iter().map(|b| b[3]).sum();
    let channel = |c: usize| {
        let (sum, of): (f64, f64) = match alpha {
            0.0 => (bytes.iter().map(|b| b[c]).sum(), 4.0),
            _ => (bytes.iter().map(|b| b[c] * b[3]).sum(), alpha),
        };
        (sum / of + 0.5).floor() as u8
    };
    u32::from_le_bytes([channel(0), channel(1), channel(2), (alpha / 4.0 + 0.5).floor() as u8])
}
