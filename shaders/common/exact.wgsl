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

// 1 / x to the nearest float, for a magnitude from 2^-125 to 2^125.
fn reciprocal(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    // x = significand * 2^(exponent - 150), and 1 / x = quotient * 2^(103 - exponent) with quotient = 2^47 / significand.
    let significand = (bits & 0x7fffffu) | 0x800000u;
    var quotient = u32(140737488355328.0 / f32(significand));
    // 2^47 - quotient * significand, whose upper bits are known: the quotient is off by a few units.
    var rest = bitcast<i32>(0u - quotient * significand);
    let divisor = bitcast<i32>(significand);
    for (var i = 0; i < 4 && rest < 0; i++) {
        quotient -= 1u;
        rest += divisor;
    }
    for (var i = 0; i < 4 && rest >= divisor; i++) {
        quotient += 1u;
        rest -= divisor;
    }
    // There are no ties.
    quotient += u32(2 * rest > divisor);
    let exponent = (bits >> 23u) & 0xffu;
    // The quotient is from 2^23 to 2^24.
    return bitcast<f32>((bits & 0x80000000u) | (((253u - exponent) << 23u) + (quotient - 0x800000u)));
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
