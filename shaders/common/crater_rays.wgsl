// Rays of fresh craters: a factor on the soil's albedo. src/scene/crater_rays.rs has the same function and constants, and explains them.

const RAYS_REACH: f32 = 16.0;
const HALO_REACH: f32 = 3.0;
const STREAK_CELLS: f32 = 7.0;
const STREAK_CELLS_PER_RADIUS: f32 = 0.3;
const MOTTLE_CELLS_PER_RADIUS: f32 = 1.6;
const MEAN_STREAK: f32 = 0.2;

// Factor on the albedo of the soil at a point (metres from the centre of the ground), where samples are `sample_m` apart.
fn crater_rays_factor(point: vec2<f32>, sample_m: f32) -> f32 {
    let contrast = relief_view().ray_contrast;
    if contrast == 0.0 { return 1.0; }
    var brightness = 0.0;
    // Craters that are not there have no radius.
    for (var k = 0u; k < 5u && relief_crater_rays(k).radius_m > 0.0; k++) {
        brightness = max(brightness, ray_brightness(relief_crater_rays(k), point, sample_m));
    }
    let shade = contrast * brightness;
    // The exponential function to second order.
    return 1.0 + shade * (1.0 + 0.5 * shade);
}

fn ray_brightness(crater: RayCrater, point: vec2<f32>, sample_m: f32) -> f32 {
    let offset = point - crater.offset;
    let per_radius = 1.0 / crater.radius_m;
    let distance_m = sqrt(dot(offset, offset));
    let r = distance_m * per_radius;
    if r >= RAYS_REACH { return 0.0; }
    let per_distance = 1.0 / (distance_m + 1.0e-3 * crater.radius_m);
    let cells = STREAK_CELLS + STREAK_CELLS_PER_RADIUS * r;
    let around = per_distance * cells * offset;
    let coarse = plane_noise(around, crater.seed);
    let fine = plane_noise(2.3 * around, crater.seed ^ 0x5bd1u);
    let raw = clamp((coarse + 0.6 * fine - 0.08) * 3.2, 0.0, 1.0);
    let mottle = plane_noise(MOTTLE_CELLS_PER_RADIUS * per_radius * offset, crater.seed ^ 0xa3c7u);
    let shown = clamp(distance_m / (cells * sample_m) - 1.0, 0.0, 1.0);
    let streak = MEAN_STREAK + shown * (raw - MEAN_STREAK);
    let left = clamp(1.0 - r / RAYS_REACH, 0.0, 1.0);
    let rays = left * streak * (0.8 + shown * mottle);
    let halo = clamp(HALO_REACH - r, 0.0, 1.0) * (0.85 + 0.3 * shown * mottle);
    return min(max(halo, rays), 1.0);
}

// `value_noise_2d` in src/scene/noise.rs, less a half.
fn plane_noise(point: vec2<f32>, seed: u32) -> f32 {
    let corner = floor(point);
    let cell = vec2<i32>(corner);
    let t = point - corner;
    let w = t * t * (3.0 - 2.0 * t);
    let south = mix(plane_value(cell, seed), plane_value(cell + vec2(1, 0), seed), w.x);
    let north = mix(plane_value(cell + vec2(0, 1), seed), plane_value(cell + vec2(1, 1), seed), w.x);
    return mix(south, north, w.y) - 0.5;
}

fn plane_value(cell: vec2<i32>, seed: u32) -> f32 {
    return f32(lattice_hash(cell.x, cell.y, 0, seed) >> 8u) * (1.0 / 16777216.0);
}
