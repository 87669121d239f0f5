// The relief of a sample, where the samples of a draw have several.

// Its index among the reliefs.
var<private> relief_slot: u32;

fn relief_noise(k: u32) -> Lattice {
    return reliefs[relief_slot].relief.noise[k];
}

fn relief_pits(k: u32) -> Lattice {
    return reliefs[relief_slot].relief.pits[k];
}

fn relief_grains(k: u32) -> Lattice {
    return reliefs[relief_slot].relief.grains[k];
}

fn relief_crater_rays(k: u32) -> RayCrater {
    return reliefs[relief_slot].relief.crater_rays[k];
}

fn relief_view() -> ReliefView {
    return reliefs[relief_slot].relief.view;
}
