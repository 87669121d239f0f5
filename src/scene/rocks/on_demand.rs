//! The rocks of a scene by index, and behind them the parts of the rover. A rock is built on first access; a frame accesses only those that survive culling.
//!
//! Must not know: which rocks a frame needs.

use std::ops::{Index, IndexMut};
use std::sync::{Arc, OnceLock};

use bytemuck::bytes_of;
use rayon::prelude::*;

use super::plan::{RockBounds, RockPlan};
use super::rock::Rock;

/// The rocks of a scene. Clones share the rocks that any of them has built.
#[derive(Clone, Debug, Default)]
pub struct Rocks(Arc<[Entry]>);

#[derive(Clone, Debug, Default)]
struct Entry {
    /// How to build it; `None` for a rock that was supplied as it is, or modified.
    plan: Option<Box<RockPlan>>,
    built: OnceLock<Rock>,
}

impl Entry {
    fn rock(&self) -> &Rock {
        self.built.get_or_init(|| self.plan.as_ref().expect("a rock without a plan is built").build())
    }

    /// The rock for modification; from now on it no longer follows its plan.
    fn rock_mut(&mut self) -> &mut Rock {
        self.rock();
        self.plan = None;
        self.built.get_mut().expect("it was just built")
    }

    fn bounds(&self) -> RockBounds {
        match &self.plan {
            Some(plan) if self.built.get().is_none() => plan.bounds,
            _ => {
                let rock = self.rock();
                RockBounds { centres: [rock.centre; 2], radius_m: rock.radius_m }
            }
        }
    }
}

impl Rocks {
    /// Number of rocks and parts of the rover.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Number of rocks, without parts of the rover, which are behind them.
    #[must_use]
    pub fn count(&self) -> usize {
        let is_part = |entry: &&Entry| entry.built.get().is_some_and(|rock| !rock.body.is_rock());
        self.0.len() - self.0.iter().rev().take_while(is_part).count()
    }

    /// Whether there are no rocks.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The rock of an index, built if necessary.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<&Rock> {
        self.0.get(index).map(Entry::rock)
    }

    /// All rocks by index; builds those that are missing.
    pub fn iter(&self) -> std::vec::IntoIter<&Rock> {
        self.0.par_iter().map(Entry::rock).collect::<Vec<_>>().into_iter()
    }

    /// All rocks for modification.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Rock> {
        Arc::make_mut(&mut self.0).iter_mut().map(Entry::rock_mut)
    }

    /// The rocks built so far, by index. Which ones depends on earlier accesses.
    pub fn built(&self) -> impl Iterator<Item = &Rock> {
        self.0.iter().filter_map(|entry| entry.built.get())
    }

    /// Builds and returns, with their indices, the rocks whose bounds satisfy a predicate.
    pub fn build_where(&self, mut predicate: impl FnMut(&RockBounds) -> bool) -> Vec<(usize, &Rock)> {
        let all = self.0.iter().enumerate();
        let wanted: Vec<(usize, &Entry)> = all.filter(|(_, entry)| predicate(&entry.bounds())).collect();
        let is_missing = |(_, entry): &(usize, &Entry)| entry.built.get().is_none();
        let missing: Vec<_> = wanted.iter().copied().filter(is_missing).collect();
        missing.into_par_iter().for_each(|(_, entry)| _ = entry.rock());
        wanted.into_iter().map(|(index, entry)| (index, entry.rock())).collect()
    }

    /// Writes the bytes that identify these rocks: all vertices of rocks without a plan; of planned ones, built or not, their
    /// position, their size and the vertices of a coarse mesh.
    pub fn write_to(&self, mut write: impl FnMut(&[u8])) {
        for (entry, index) in self.0.iter().zip(0_u32..) {
            write(&index.to_le_bytes());
            if let Some(plan) = &entry.plan {
                plan.write_to(entry.built.get(), &mut write);
            } else {
                let rock = entry.rock();
                write(bytes_of(&rock.centre));
                write(bytemuck::cast_slice(&rock.vertices));
            }
        }
    }

    /// These without the parts of a rover.
    #[must_use]
    pub(in crate::scene) fn without_parts(self) -> Self {
        let count = self.count();
        if count == self.len() { self } else { Self(self.0[..count].iter().cloned().collect()) }
    }

    /// These, with further ones behind them.
    #[must_use]
    pub(in crate::scene) fn with(mut self, more: Vec<Rock>) -> Self {
        let more = more.into_iter().map(|rock| Entry { plan: None, built: OnceLock::from(rock) });
        let entries = Arc::make_mut(&mut self.0).iter_mut().map(std::mem::take);
        Self(entries.chain(more).collect())
    }

    /// Rocks that are built on first access.
    pub(super) fn planned(plans: impl Iterator<Item = RockPlan>) -> Self {
        Self(plans.map(|plan| Entry { plan: Some(Box::new(plan)), built: OnceLock::new() }).collect())
    }
}

impl<'a> IntoIterator for &'a Rocks {
    type Item = &'a Rock;
    type IntoIter = std::vec::IntoIter<&'a Rock>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl Index<usize> for Rocks {
    type Output = Rock;

    fn index(&self, index: usize) -> &Rock {
        self.0[index].rock()
    }
}

impl IndexMut<usize> for Rocks {
    fn index_mut(&mut self, index: usize) -> &mut Rock {
        Arc::make_mut(&mut self.0)[index].rock_mut()
    }
}

impl From<Vec<Rock>> for Rocks {
    fn from(rocks: Vec<Rock>) -> Self {
        Self(rocks.into_iter().map(|rock| Entry { plan: None, built: OnceLock::from(rock) }).collect())
    }
}
