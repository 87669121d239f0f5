// Arithmetic with the same result, to the bit, on every device.
//
// A device may round a product and the sum that it is part of once instead of twice, may reorder sums, and may divide with an error of
// 2.5 units in the last place (Vulkan specification, "Precision and Operation of SPIR-V Instructions"; WGSL specification, "Floating
// Point Accuracy"). Integers leave no such choice: what passes through one is rounded, and nothing is fused across it.

// A number that was rounded. `frame.zero` is 0, which compilers do not know.
fn exact(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ frame.zero);
}

fn exact2(v: vec2<f32>) -> vec2<f32> {
    return bitcast<vec2<f32>>(bitcast<vec2<u32>>(v) ^ vec2(frame.zero));
}

fn exact3(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) ^ vec3(frame.zero));
}

fn exact_dot(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let products = exact3(a * b);
    return exact(exact(products.x + products.y) + products.z);
}

fn exact_dot2(a: vec2<f32>, b: vec2<f32>) -> f32 {
    let products = exact2(a * b);
    return exact(products.x + products.y);
}

// 1 / x as `quotient`.
fn reciprocal(x: f32) -> f32 {
    return quotient(1.0, x);
}

// a / b to the nearest float; 0 where it is smaller than 2^-126. Neither `b` nor the quotient may be larger than 2^125, nor `b` smaller than
// 2^-126.
fn quotient(a: f32, b: f32) -> f32 {
    let bits = vec2(bitcast<u32>(a), bitcast<u32>(b));
    let significands = (bits & vec2(0x7fffffu)) | vec2(0x800000u);
    // The quotient of the significands, of 24 bits: that of the first one times 2^shift.
    let shift = select(24u, 23u, significands.x >= significands.y);
    let scale = select(16777216.0, 8388608.0, shift == 23u);
    var whole = u32(scale * (f32(significands.x) / f32(significands.y)));
    // What is left over, whose upper bits are known: the division is off by a few units, four at most.
    var rest = bitcast<i32>((significands.x << shift) - whole * significands.y);
    let divisor = bitcast<i32>(significands.y);
    let too_small = vec4<i32>(vec4(rest) >= divisor * vec4(1, 2, 3, 4));
    let too_large = vec4<i32>(vec4(rest) < divisor * vec4(0, -1, -2, -3));
    let missing = too_small - too_large;
    let units = missing.x + missing.y + missing.z + missing.w;
    whole += bitcast<u32>(units);
    rest -= units * divisor;
    // There are no ties. A quotient that is rounded up to 2^24 has the next exponent.
    whole += u32(2 * rest > divisor);
    let exponents = vec2<i32>((bits >> vec2(23u)) & vec2(0xffu));
    let exponent = exponents.x - exponents.y + 150 - i32(shift);
    let magnitude = (u32(exponent) << 23u) + (whole - 0x800000u);
    let sign = (bits.x ^ bits.y) & 0x80000000u;
    return bitcast<f32>(select(sign | magnitude, sign, exponents.x == 0 || exponent < 1));
}

// A signed integer of 64 bits.
struct WideInteger {
    high: i32,
    low: u32,
}

// Of two integers of 24 bits and a sign.
fn wide_product(a: i32, b: i32) -> WideInteger {
    let low_a = u32(a) & 0xffffu;
    let low_b = u32(b) & 0xffffu;
    let middle = i32(low_a) * (b >> 16u) + (a >> 16u) * i32(low_b);
    let lowest = low_a * low_b;
    let low = lowest + (u32(middle) << 16u);
    return WideInteger((a >> 16u) * (b >> 16u) + (middle >> 16u) + i32(low < lowest), low);
}

fn wide_difference(a: WideInteger, b: WideInteger) -> WideInteger {
    return WideInteger(a.high - b.high - i32(a.low < b.low), a.low - b.low);
}

// Divided by 256 and rounded down; 2^30 or its negative of what is beyond.
fn wide_over_256(a: WideInteger) -> i32 {
    if a.high >= 64 { return 1 << 30u; }
    if a.high < -64 { return -(1 << 30u); }
    return (a.high << 24u) | i32(a.low >> 8u);
}
