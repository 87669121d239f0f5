// The relief of a draw, whose samples all have the same.

fn relief_noise(k: u32) -> Lattice {
    return relief.noise[k];
}

fn relief_pits(k: u32) -> Lattice {
    return relief.pits[k];
}

fn relief_grains(k: u32) -> Lattice {
    return relief.grains[k];
}

fn relief_crater_rays(k: u32) -> RayCrater {
    return relief.crater_rays[k];
}

fn relief_view() -> ReliefView {
    return relief.view;
}
