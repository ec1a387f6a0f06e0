// One row of floats for each Gaussian: the gradients from the projection's backward pass. ROW_* are offsets into it.

/// Floats of a row.
const uint ROW = 18;
/// Gradient by the mean, three floats.
const uint ROW_MEAN = 0;
/// Gradient by the log scales, three floats.
const uint ROW_LOG_SCALE = 3;
/// Gradient by the stored quaternion, four floats.
const uint ROW_ROTATION = 6;
/// Gradient by the opacity logit, one float.
const uint ROW_LOGIT = 10;
/// Gradient by the colour before its clamp at 0, three floats.
const uint ROW_COLOUR = 11;
/// Unit vector of the view, three floats: the optimiser evaluates the SH basis on it again.
const uint ROW_DIRECTION = 14;
/// 1; or 0 if a gradient is not finite, so that none of the Gaussian's parameters may change.
const uint ROW_GOOD = 17;
