// From linear radiance to 8-bit sRGB. CPU counterpart: `tone` in src/render/resolve/tone.rs.

// Display-linear value up to which the tone curve is the identity.
override TONE_KNEE: f32;
// Limit of the curve for endless radiance, display-linear.
override TONE_WHITE: f32;

// Linear up to the knee, then an exponential shoulder that starts with the same slope and approaches TONE_WHITE. The curve
// applies to the largest channel and the others keep their ratio to it, which preserves the hue.
fn tone(x: vec3<f32>) -> vec3<f32> {
    let largest = max(x.r, max(x.g, x.b));
    if largest <= TONE_KNEE { return x; }
    let room = TONE_WHITE - TONE_KNEE;
    let shoulder = TONE_KNEE + room * (1.0 - exp(-(largest - TONE_KNEE) / room));
    return x * (shoulder / largest);
}

// The sRGB transfer function (IEC 61966-2-1), linear to encoded.
fn srgb_from_linear(x: vec3<f32>) -> vec3<f32> {
    let curve = 1.055 * pow(max(x, vec3(0.0)), vec3(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * x, x <= vec3(0.0031308));
}
