// Constants of density control.

/// ln 1.6: ratio of a parent's scales to those of its halves (3DGS's value).
const float LN_SHRINK = 0.4700036292457356;
/// Distance of halves along the longest axis from the parent's middle, in its deviations: three times 0.45.
const float HALF_APART = 1.35;
/// -ln 0.55, by which they are shorter, so that three deviations end where the parent's do.
const float LN_SHORTER = 0.5978370007556204;
/// -ln sqrt(1 - 0.45^2), by which they are thinner.
const float LN_THINNER = 0.11313672216156874;
/// Their share of the parent's opacity (values of Improved-GS).
const float HALF_OPACITY = 0.6;
/// A row of the new model that existed before.
const uint KEPT = 0;
/// The second of two copies of a row.
const uint CLONE = 1;
/// One of the two halves that replace their parent.
const uint HALF = 2;
/// The other half.
const uint OTHER_HALF = 3;
