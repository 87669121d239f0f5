// Bind group 1, the scene: instances, shadow tiles, relief. The structs have Rust counterparts of the same name in
// src/render/device/shader_structs.rs (`Lattice`: `LatticeUniforms`).

// Largest radiance that half floats hold: what is brighter is stored as this (src/scene/sky.rs has the same).
const MAX_STORED_RADIANCE: f32 = 65504.0;

// One drawn object. Class and instance ids are data: no shader knows what a rock is.
struct Instance {
    // Origin of the mesh, metres, world.
    origin: vec3<f32>,
    // Factor on the mesh's coordinates.
    scale: f32,
    // Albedo of a surface, linear RGB; mean radiance of an object in the sky.
    colour: vec3<f32>,
    // Roughness of the diffuse lobe.
    roughness: f32,
    class_id: u32,
    instance_id: u32,
    // Amplitude of the opposition surge (Hapke's B_S0).
    surge_height: f32,
    // Of a caster: half the side of its shadow tile, metres.
    tile_half_extent_m: f32,
    // Albedo of the dust on it, and the least z of a normal that holds dust.
    dust: vec3<f32>,
    dust_min_normal_z: f32,
    // Of a caster: corner and side of its shadow tile, texels.
    tile_origin_px: vec2<f32>,
    tile_size_px: f32,
    // Detail below the mesh (common/shading.wgsl), and above its 8 bits the index of the relief.
    detail: u32,
    // Amplitude of the opposition surge of the dust on it.
    dust_surge_height: f32,
    // Of a rock: its diameter, metres; 0 of what has no texture.
    diameter_m: f32,
    // Of a rock: height of the ground around it, metres, world; one over its own height above that.
    ground_z: f32,
    per_height: f32,
    // Of a rock, light of its surroundings (src/render/select/rock_light.rs). On upright faces towards the sun, to its left, away from it, to
    // its right: that of ground below the horizon, relative to a rock in the open; that of rocks and from above the horizon, relative to
    // uniform light of the ground's radiance. The latter on a level face.
    lit_below: vec4<f32>,
    lit_beside: vec4<f32>,
    lit_on_top: f32,
    // Of the sun's disc: the sine of half the angle that it spans; else 0.
    disc_sine: f32,
    reserved_pair: vec2<u32>,
}

// A caster's tile in the shadow atlas.
struct CasterTile {
    // Centre of the caster, metres, world.
    centre: vec3<f32>,
    // Half the side of the square across the sun, and half the depth range along it, metres.
    half_extent_m: f32,
    // Corner of the tile, texels.
    origin_px: vec2<f32>,
    // Side of the tile, texels.
    size_px: f32,
    // Length of an edge of the caster's triangles, metres.
    edge_m: f32,
}

// Dynamic offsets of uniforms are multiples of 256 bytes.
struct InstanceSlot {
    instance: Instance,
    unused: array<vec4<u32>, 7>,
}

// A square lattice over the plane, for points in metres from the centre of the ground.
struct Lattice {
    // Cosine and sine of its angle, divided by the side of a cell.
    rotation_per_m: vec2<f32>,
    // Position of the centre in its cell, cells.
    phase: vec2<f32>,
    // The cell of the centre.
    base: vec2<i32>,
    seed: u32,
    // Of noise: its amplitude, metres. Of pits and grains: the probability that a cell has one.
    amount: f32,
    // Side of a cell, metres.
    cell_m: f32,
    // Largest diameter of a pit or grain, metres.
    max_diameter_m: f32,
    // Of noise: amplitude of the logarithm of the soil's albedo. Of pits: fraction that are clods. Of grains: fraction that are
    // fragments of rock.
    share: f32,
    // Of noise: 1 if its amplitude differs from place to place, else 0. Of grains: by how much they make the ground brighter than the soil
    // between them, relative to the latter.
    factor: f32,
}

// The part of the relief that a draw needs.
struct ReliefView {
    // Horizontal position of the eye, metres from the centre of the ground.
    eye_from_centre: vec2<f32>,
    // Height of the eye that the mesh is built for, metres.
    eye_height_m: f32,
    // Angle that a cell of the mesh spans from there, radians.
    cell_angle: f32,
    // Angle between two samples, radians.
    sample_angle: f32,
    // Fraction of the craters that are fresh.
    fresh_share: f32,
    // Octaves of noise, lattices of pits and of grains in use.
    waves: u32,
    pit_lattices: u32,
    grain_lattices: u32,
    // Median albedo of fragments of rock relative to the soil's, and the deviation of its logarithm.
    grain_ratio: f32,
    grain_spread: f32,
    // Logarithm of the albedo of the brightest rays of craters over that of the soil; 0 if there are none.
    ray_contrast: f32,
}

// A crater with rays.
struct RayCrater {
    // Centre, metres from the centre of the ground.
    offset: vec2<f32>,
    // Radius, metres; 0 if there is none.
    radius_m: f32,
    seed: u32,
}

struct ReliefUniforms {
    view: ReliefView,
    // Coarse to fine.
    noise: array<Lattice, 12>,
    pits: array<Lattice, 14>,
    grains: array<Lattice, 5>,
    // Those whose rays matter most first.
    crater_rays: array<RayCrater, 5>,
}

// Dynamic offsets of uniforms are multiples of 256 bytes.
struct ReliefSlot {
    relief: ReliefUniforms,
    unused: array<vec4<u32>, 11>,
}

// The instance of the draw, if all of its samples show the same.
@group(1) @binding(0) var<uniform> instance: Instance;
// `CasterTile`s, each in two loads.
@group(1) @binding(1) var<storage, read> tiles: array<array<vec4<f32>, 2>>;
// The relief of the draw (src/render/lighting/relief_bands.rs).
@group(1) @binding(2) var<uniform> relief: ReliefUniforms;
// All instances.
@group(1) @binding(3) var<storage, read> instances: array<InstanceSlot>;
// All reliefs.
@group(1) @binding(4) var<storage, read> reliefs: array<ReliefSlot>;
