// What one draw of the scene pass writes: one location per `Plane` (src/render/targets.rs), always all of them.

struct SceneOut {
    // Linear radiance; alpha is 1 and unused.
    @location(0) radiance: vec4<f32>,
    @location(1) class_id: u32,
}
