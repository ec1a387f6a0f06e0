// Constants of density control.

/// ln 1.6: the halves of a split are so much smaller than their parent (3DGS's value).
const float LN_SHRINK = 0.4700036292457356;
/// Halves along the longest axis lie so many deviations of the parent from its middle: three times 0.45, ...
const float HALF_APART = 1.35;
/// ... are by -ln 0.55 shorter, so that three deviations end where the parent's do, ...
const float LN_SHORTER = 0.5978370007556204;
/// ... by -ln sqrt(1 - 0.45^2) thinner, ...
const float LN_THINNER = 0.11313672216156874;
/// ... and have this share of its opacity (values of Improved-GS).
const float HALF_OPACITY = 0.6;
/// A row of the new model that was there before.
const uint KEPT = 0;
/// The second of two copies of a row.
const uint CLONE = 1;
/// One of the two halves that replace their parent.
const uint HALF = 2;
/// The other half.
const uint OTHER_HALF = 3;
