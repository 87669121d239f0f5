//! Test of the arithmetic that labels depend on where a compute pass rasterises.

use bytemuck::Zeroable;

use crate::gpu::adapter::adapter_of_tests;
use crate::gpu::{Gpu, shader_check};
use crate::random::Streams;
use crate::render::device::shader_structs::FrameUniforms;

/// Of each row: the quotient of the first and the sixth number in place of the first, and in place of the next an integer of 64 bits over 256: the product of
/// the second and third less that of the fourth and fifth. Then, of the last three numbers, a sum of products in place of the first of them.
const ENTRY: &str = "
@group(0) @binding(1) var<storage, read_write> rows: array<array<u32, 8>>;
@compute @workgroup_size(64)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&rows) { return; }
    let row = rows[id.x];
    rows[id.x][0] = bitcast<u32>(quotient(bitcast<f32>(row[5]), bitcast<f32>(row[0])));
    let products = wide_difference(
        wide_product(bitcast<i32>(row[1]), bitcast<i32>(row[2])),
        wide_product(bitcast<i32>(row[3]), bitcast<i32>(row[4])),
    );
    rows[id.x][1] = bitcast<u32>(wide_over_256(products));
    let v = bitcast<vec3<f32>>(vec3(row[5], row[6], row[7]));
    rows[id.x][5] = bitcast<u32>(exact_dot(v, v.yzx));
}";

/// Rows of the test.
const ROWS: usize = 200_000;

#[test]
fn shaders_compute_what_labels_depend_on_as_the_host_does() {
    let draw = &mut Streams::new(1).stream("tests.exact", 0);
    let mut rows = Vec::with_capacity(ROWS);
    for number in 0..ROWS {
        // Numbers of magnitudes from 2^-100 to 2^100, and those next to powers of two.
        let exponent = draw.uniform_int(27, 227) as u32;
        let significand = match number % 8 {
            0 => draw.uniform_int(0, 3) as u32,
            1 => 0x7f_ffff - draw.uniform_int(0, 3) as u32,
            _ => draw.bits() & 0x7f_ffff,
        };
        let any = (draw.bits() & 1 << 31) | exponent << 23 | significand;
        let large = 1_i64 << draw.uniform_int(1, 24);
        let mut integer = || (draw.uniform_int(-large, large) as i32).cast_unsigned();
        let integers = [integer(), integer(), integer(), integer()];
        let mut float = || (draw.uniform(-600.0, 600.0) as f32).to_bits();
        let [a, b, c, d] = integers;
        // Every other quotient is a reciprocal.
        let numerator = if number % 2 == 0 { 1.0_f32.to_bits() } else { float() };
        rows.push([any, a, b, c, d, numerator, float(), float()]);
    }
    let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
    let text = [
        include_str!("../../../shaders/common/frame.wgsl"),
        include_str!("../../../shaders/common/exact.wgsl"),
        ENTRY,
    ];
    let uniforms = FrameUniforms::zeroed();
    let found = shader_check::run(&gpu, &text.concat(), bytemuck::bytes_of(&uniforms), &rows);
    let mut beyond = 0;
    for (row, found) in rows.iter().zip(found) {
        let [x, y, z] = [row[5], row[6], row[7]].map(f32::from_bits);
        let quotient = x / f32::from_bits(row[0]);
        assert_eq!(found[0], quotient.to_bits(), "{x} / {}", f32::from_bits(row[0]));
        let [a, b, c, d] = [row[1], row[2], row[3], row[4]].map(|v| i64::from(v.cast_signed()));
        let expected = (a * b - c * d) >> 8;
        // Beyond 2^30 the sign is all that counts.
        let is_beyond = expected.abs() >= 1 << 30;
        let expected = expected.clamp(-(1 << 30), 1 << 30) as i32;
        assert_eq!(found[1].cast_signed(), expected, "{a} * {b} - {c} * {d}");
        beyond += usize::from(is_beyond);
        assert_eq!(f32::from_bits(found[5]), x * y + y * z + z * x, "{x}, {y}, {z}");
    }
    assert!(beyond > ROWS / 100 && beyond < ROWS / 2, "{beyond} are beyond");
}
