// Constants of blending, from the 3DGS reference implementation; see docs/method.md.

/// Contributions with a lower opacity are skipped: 1/255, one step of an 8-bit picture.
const float ALPHA_MIN = 0.00392156862745098;
/// 1 / `ALPHA_MIN`, by which kernels multiply.
const float ALPHA_MIN_INVERSE = 255.0;
/// Greatest opacity of one contribution: it leaves some weight to what lies behind, and a divisor 1 - alpha to the backward pass.
const float ALPHA_MAX = 0.99;
/// Blending ends before transmittance falls below this. Two saturated layers leave 1e-4 minus a rounding error: the margin
/// above 1e-4 settles the tie.
const float TRANSMITTANCE_STOP = 1.00001e-4;
