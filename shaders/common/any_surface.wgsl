// Lighting of a sample by what its instance says.

// Bits of `Instance.detail` below the index of its relief. `Detail` in src/render/device/shading_bins.rs has the same.
const DETAIL_BITS: u32 = 8u;
// The detail of what emits light.
const DETAIL_EMISSIVE: u32 = 4u;

// Whether no draw wrote a sample: no surface is in slot 0 with an inverse depth of 0.
fn is_unwritten(position: vec2<f32>) -> bool {
    return all(textureLoad(visibility_buffer, vec2<i32>(position), 0) == vec4(0u));
}

// The planes of a sample that a draw wrote, given by its framebuffer position.
fn light_sample(position: vec2<f32>) -> LightingOutput {
    let surface = surface_at(position);
    let instance = instances[surface.slot].instance;
    let detail = instance.detail & ((1u << DETAIL_BITS) - 1u);
    if detail == DETAIL_EMISSIVE {
        // The sky's inverse depth is 0: it has no offset.
        let radiance = emitted_radiance(instance.colour, instance.disc_sine, ray_through(position));
        return lighting_output(vec4(radiance, 1.0), instance.class_id, vec4(0.0), 0u, 0.0);
    }
    relief_slot = instance.detail >> DETAIL_BITS;
    let view = reliefs[relief_slot].relief.view;
    light.relief_eye_from_centre = view.eye_from_centre;
    light.relief_eye_height_m = view.eye_height_m;
    light.relief_cell_angle = view.cell_angle;
    light.relief_sample_angle = view.sample_angle;
    light.relief_fresh_share = view.fresh_share;
    light.relief_waves = view.waves;
    light.relief_pit_lattices = view.pit_lattices;
    light.relief_grain_lattices = view.grain_lattices;
    return shade(surface, instance, detail, position);
}
