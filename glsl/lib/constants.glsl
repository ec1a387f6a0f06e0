// Constants of image formation; the reference's, see docs/method.md.
const float ALPHA_MIN = 1.0 / 255.0;   // fainter contributions are skipped
const float ALPHA_MAX = 0.99;
const float TRANSMITTANCE_STOP = 1.00001e-4; // two saturated layers leave 1e-4 less rounding: the margin settles the tie
const float MIN_QUATERNION = 1e-6;     // largest component below which a quaternion is no rotation
const float MIN_ANTIALIAS = 2.5e-5;    // floor of det0 / det under the root
const float LOG2_E = 1.4426950408889634;
