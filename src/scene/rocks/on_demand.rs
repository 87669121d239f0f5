//! The rocks of a scene, by number, each built when it is first asked for: a picture asks for those that it may show alone.
//!
//! Must not know: what a picture shows.

use std::ops::{Index, IndexMut};
use std::sync::{Arc, OnceLock};

use bytemuck::bytes_of;
use glam::Vec3;
use rayon::prelude::*;

use super::{Plan, Rock};

/// The rocks of a scene. Copies of it share those that were built, whichever asked for them.
#[derive(Clone, Debug, Default)]
pub struct Rocks(Arc<[Entry]>);

#[derive(Clone, Debug)]
struct Entry {
    /// How to build it; none of a rock that was given as it is, or changed.
    plan: Option<Plan>,
    built: OnceLock<Rock>,
}

/// Where all of a rock lies: within a ball somewhere on the way from one place to another above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Whereabouts {
    /// Lowest and highest place for its centre, metres.
    pub centres: [Vec3; 2],
    /// Not less than its greatest distance from the centre, metres.
    pub radius_m: f32,
}

impl Whereabouts {
    /// Whether the rock may be so near to a point.
    #[must_use]
    pub fn may_lie_within(&self, limit_m: f32, point: Vec3) -> bool {
        let [low, high] = self.centres;
        let nearest = low.with_z(point.z.clamp(low.z, high.z));
        nearest.distance(point) <= self.radius_m + limit_m
    }
}

impl Entry {
    fn rock(&self) -> &Rock {
        self.built.get_or_init(|| self.plan.as_ref().expect("one without a plan is there").build())
    }

    /// From here on it is as it is made now, not as it was planned.
    fn rock_mut(&mut self) -> &mut Rock {
        self.rock();
        self.plan = None;
        self.built.get_mut().expect("it was just built")
    }

    fn whereabouts(&self) -> Whereabouts {
        match &self.plan {
            Some(plan) if self.built.get().is_none() => plan.whereabouts,
            _ => {
                let rock = self.rock();
                Whereabouts { centres: [rock.centre; 2], radius_m: rock.radius_m }
            }
        }
    }
}

impl Rocks {
    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The rock of a number, built if it was not yet.
    #[must_use]
    pub fn get(&self, number: usize) -> Option<&Rock> {
        self.0.get(number).map(Entry::rock)
    }

    /// All of them, by number; those that were not built are.
    pub fn iter(&self) -> std::vec::IntoIter<&Rock> {
        self.0.par_iter().map(Entry::rock).collect::<Vec<_>>().into_iter()
    }

    /// All of them, to be changed.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Rock> {
        Arc::make_mut(&mut self.0).iter_mut().map(Entry::rock_mut)
    }

    /// Those that were built so far, by number. Which they are depends on what was asked for.
    pub fn built(&self) -> impl Iterator<Item = &Rock> {
        self.0.iter().filter_map(|entry| entry.built.get())
    }

    /// Those of which something holds, with their numbers; no rock is built but for them. What is asked is whether it may hold
    /// of a rock that lies somewhere there.
    pub fn that_may(&self, mut may: impl FnMut(&Whereabouts) -> bool) -> Vec<(usize, &Rock)> {
        let all = self.0.iter().enumerate();
        let wanted: Vec<(usize, &Entry)> = all.filter(|(_, entry)| may(&entry.whereabouts())).collect();
        let is_missing = |(_, entry): &(usize, &Entry)| entry.built.get().is_none();
        let missing: Vec<_> = wanted.iter().copied().filter(is_missing).collect();
        missing.into_par_iter().for_each(|(_, entry)| _ = entry.rock());
        wanted.into_iter().map(|(number, entry)| (number, entry.rock())).collect()
    }

    /// Gives the bytes of what tells these rocks from others: all vertices of those that were given as they are; of those that
    /// are built when they are asked for, whether they were or not, what lays them and the vertices of their coarsest mesh.
    pub fn write_to(&self, mut write: impl FnMut(&[u8])) {
        for (entry, number) in self.0.iter().zip(0_u32..) {
            write(&number.to_le_bytes());
            if let Some(plan) = &entry.plan {
                plan.write_to(entry.built.get(), &mut write);
            } else {
                let rock = entry.rock();
                write(bytes_of(&rock.centre));
                write(bytemuck::cast_slice(&rock.vertices));
            }
        }
    }

    /// Those that are built when they are asked for.
    pub(super) fn planned(plans: impl Iterator<Item = Plan>) -> Self {
        Self(plans.map(|plan| Entry { plan: Some(plan), built: OnceLock::new() }).collect())
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

    fn index(&self, number: usize) -> &Rock {
        self.0[number].rock()
    }
}

impl IndexMut<usize> for Rocks {
    fn index_mut(&mut self, number: usize) -> &mut Rock {
        Arc::make_mut(&mut self.0)[number].rock_mut()
    }
}

impl From<Vec<Rock>> for Rocks {
    fn from(rocks: Vec<Rock>) -> Self {
        Self(rocks.into_iter().map(|rock| Entry { plan: None, built: OnceLock::from(rock) }).collect())
    }
}
