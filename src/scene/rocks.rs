//! The rocks: their shapes, how they lie on the ground, and where they lie on the two stages ([`nominal`], [`lunar`] with [`lunar_rocks`]).

pub mod burial;
mod dust;
pub mod fillets;
mod form;
pub mod lunar;
pub mod lunar_rocks;
mod lunar_shape;
pub mod nominal;
pub mod on_demand;
mod plan;
mod rock;
mod scatter;
mod shape;

pub use nominal::plan;
pub use plan::RockBounds;
pub use rock::{Body, EYE_CLEARANCE_M, Material, NO_DUST, Rock};
