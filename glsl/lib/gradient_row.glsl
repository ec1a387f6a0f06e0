// What projection's backward pass leaves for each Gaussian: offsets into a row of floats.
const uint ROW = 18;
const uint ROW_MEAN = 0;
const uint ROW_LOG_SCALE = 3;
const uint ROW_ROTATION = 6;
const uint ROW_LOGIT = 10;
const uint ROW_COLOUR = 11;    // by the radiance before its clamp
const uint ROW_DIRECTION = 14; // unit vector of the view: SH bases are evaluated on it again
const uint ROW_GOOD = 17;      // 0 where a gradient is not finite: the whole row of parameters then stays
