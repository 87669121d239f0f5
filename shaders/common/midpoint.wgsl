// The surface that a midpoint shadow map stores: halfway between the front and the back faces of a caster as seen from the sun (Woo 1992,
// "The Shadow Depth Map Revisited", Graphics Gems III), but no more than some texels behind the front.

// Texels that depths from 0 to 1 span: the side of the largest tile. src/render/select/casters.rs has the same.
const DEPTH_RANGE_PX: f32 = 2048.0;
// Height of texels without a caster: far below. src/render/shadow/host.rs has the same constants, and explains the second.
const NO_CASTER: f32 = -1.0e9;
const MAX_BEHIND_FRONT_PX: f32 = 4.0;

// Height along the sun above the caster's centre, texels, between these depths of front and back; a front of 0 is none.
fn height_between(front: f32, back: f32) -> f32 {
    let depth = max(0.5 * (front + back), front - MAX_BEHIND_FRONT_PX / DEPTH_RANGE_PX);
    return select(DEPTH_RANGE_PX * (depth - 0.5), NO_CASTER, front == 0.0);
}
