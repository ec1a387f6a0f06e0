// Constants of density control.

/// ln 1.6: the halves of a split are so much smaller than their parent (3DGS's value).
const float LN_SHRINK = 0.4700036292457356;
/// A row of the new model that was there before.
const uint KEPT = 0;
/// The second of two copies of a row.
const uint CLONE = 1;
/// One of the two halves that replace their parent.
const uint HALF = 2;
