// The things in the scene. Twins: `Instance`, `CasterTile` in src/render/shaders.rs.

// One drawn thing. Class and instance ids are data of the scene: no shader knows what a rock is.
struct Instance {
    // Place of the mesh's origin, metres, world.
    origin: vec3<f32>,
    // Factor on the mesh's coordinates.
    scale: f32,
    // Diffuse reflectance of a surface, radiance of a thing of the sky.
    colour: vec3<f32>,
    // Roughness of the diffuse lobe.
    roughness: f32,
    class_id: u32,
    instance_id: u32,
    // Height of the opposition surge.
    surge: f32,
    // Of a caster, half the side of its shadow tile, metres.
    tile_half_extent_m: f32,
    // Reflectance of the soil that lies on it, and from which z of the normal on.
    dust: vec3<f32>,
    dust_above: f32,
    // LightVaryings and side of the tile, texels.
    tile_origin_px: vec2<f32>,
    tile_size_px: f32,
    reserved: u32,
}

// Where in the shadow atlas a caster is drawn.
struct CasterTile {
    // Centre of the caster, metres, world.
    centre: vec3<f32>,
    // Half the side of the square across the sun (and half the depth range along it), metres.
    half_extent_m: f32,
    // LightVaryings of the tile, texels.
    origin_px: vec2<f32>,
    // Side of the tile, texels.
    size_px: f32,
    // Length of the edges of the caster's facets, metres.
    facet_m: f32,
}

// Uniforms start at multiples of 256 bytes.
struct InstanceSlot {
    instance: Instance,
    unused: array<vec4<u32>, 11>,
}

// The one that is lit, where all samples of a draw show the same: a uniform, so that none has to find it in a list.
@group(1) @binding(0) var<uniform> instance: Instance;
// `CasterTile`s, each in two fetches.
@group(1) @binding(1) var<storage, read> tiles: array<array<vec4<f32>, 2>>;
// All of them.
@group(1) @binding(3) var<storage, read> instances: array<InstanceSlot>;
