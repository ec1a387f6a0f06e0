// Constants of blending, those of the 3DGS reference implementation; see docs/method.md.

/// Contributions of a lower opacity are skipped: 1/255, one step of an 8-bit picture.
const float ALPHA_MIN = 0.00392156862745098;
/// 1 / `ALPHA_MIN`, which kernels multiply by instead.
const float ALPHA_MIN_INVERSE = 255.0;
/// Greatest opacity of one contribution: what lies behind it keeps some weight, and the backward pass a divisor 1 - alpha.
const float ALPHA_MAX = 0.99;
/// Blending ends before transmittance falls below this. Two saturated layers leave 1e-4 minus a rounding error: the margin
/// above 1e-4 settles the tie.
const float TRANSMITTANCE_STOP = 1.00001e-4;
