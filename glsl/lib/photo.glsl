// The fourth byte of a photo's pixels.

/// The fourth byte has no meaning.
const uint OPAQUE = 0;
/// The fourth byte is the opacity of the photo over the background.
const uint OPACITY = 1;

// Value of a channel in a pixel of a photo, 8 bits each.
float photo_value(uint pixel, uint channel, uint fourth_byte, float background) {
    float value = float((pixel >> (8 * channel)) & 255u) * (1 / 255.0);
    if (fourth_byte == OPACITY) {
        float opacity = float(pixel >> 24) / 255.0;
        value = value * opacity + background * (1 - opacity);
    }
    return value;
}
