// What a lighting draw writes: one location per `Plane` (src/render/lighting/gbuffer.rs), always all of them.

struct LightingOutput {
    // Linear radiance; alpha is 1 and unused.
    @location(0) radiance: vec4<f32>,
    @location(1) class_id: u32,
    // World normal; alpha is 1 and unused. 0 for the sky.
    @location(2) normal: vec4<f32>,
    // 0 for what is no instance.
    @location(3) instance_id: u32,
    // Fraction of the sun's disc that is occluded. 0 for the sky.
    @location(4) sun_occlusion: f32,
}
