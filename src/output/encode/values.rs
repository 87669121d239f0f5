//! The values of the outputs that are no plane of a frame, rows of pixels from top to bottom.
//!
//! Must not know: file formats.

use super::EncodeInput;
use super::label_sets::{FIVE_CLASSES, LARGE_ROCK_M, ROCK_SIZE_CLASSES};
use crate::class::ClassId;
use crate::frame::Frame;

/// The semantic mask in the numbering and under the edge policy of the input.
pub(in crate::output) fn mask(input: &EncodeInput<'_>) -> Vec<u8> {
    input.classes().iter().map(|id| input.label_ids.mask_id(*id)).collect()
}

/// The mask in the preview colours of its classes; unlabelled pixels are black.
pub(in crate::output) fn preview(input: &EncodeInput<'_>) -> Vec<u8> {
    let colour = |id: &u8| ClassId(*id).class().map_or([0; 3], |class| class.preview_rgb);
    input.classes().iter().flat_map(colour).collect()
}

/// Length of the ray from the camera, metres; infinite for the sky.
pub(in crate::output) fn camera_distance(frame: &Frame) -> Vec<f32> {
    let along_ray = |(pixel, depth_m): (u32, &f32)| {
        let x = f64::from(pixel % frame.width) + 0.5 - f64::from(frame.width) / 2.0;
        let y = f64::from(pixel / frame.width) + 0.5 - f64::from(frame.height) / 2.0;
        let [x, y] = frame.lens.undistort([x / frame.focal_px, y / frame.focal_px]);
        (f64::from(*depth_m) * (1.0 + x * x + y * y).sqrt()) as f32
    };
    (0..).zip(&frame.depth_m).map(along_ray).collect()
}

/// Fraction of a pixel's samples that belong to each class, by class id. Those that show the rover belong to none.
pub(in crate::output) fn coverage(frame: &Frame) -> Vec<f32> {
    let share = |count: &u8| f32::from(*count) / frame.samples as f32;
    frame.sample_counts.as_flattened().iter().map(share).collect()
}

/// The five classes, unlabelled where the mask is under the edge policy.
pub(in crate::output) fn five_classes(input: &EncodeInput<'_>) -> Vec<u8> {
    let unlabelled = ClassId::UNLABELLED.0;
    let id = |(class, id): (&u8, &u8)| if *class == unlabelled { unlabelled } else { *id };
    input.classes().iter().zip(&input.frame.five_classes).map(id).collect()
}

/// The same in colours; unlabelled pixels are black.
pub(in crate::output) fn five_classes_preview(input: &EncodeInput<'_>) -> Vec<u8> {
    let colour = |id: &u8| FIVE_CLASSES.get(usize::from(*id)).map_or([0; 3], |(.., rgb)| *rgb);
    five_classes(input).iter().flat_map(colour).collect()
}

/// The mask in colours, with small and large rocks distinguished.
pub(in crate::output) fn rock_sizes(input: &EncodeInput<'_>) -> Vec<u8> {
    let frame = input.frame;
    let max_instance = frame.rocks.iter().map(|rock| rock.instance).max().unwrap_or(0);
    let mut is_large = vec![false; usize::from(max_instance) + 1];
    for rock in &frame.rocks {
        is_large[usize::from(rock.instance)] = rock.diameter_m >= LARGE_ROCK_M;
    }
    let colour = |(id, instance): (&u8, &u16)| {
        let row = match ClassId(*id) {
            ClassId::SKY => 3,
            ClassId::UNLABELLED => 4,
            ClassId::ROCK => 1 + usize::from(is_large.get(usize::from(*instance)) == Some(&true)),
            _ => 0,
        };
        ROCK_SIZE_CLASSES[row].1
    };
    input.classes().iter().zip(&frame.instances).flat_map(colour).collect()
}
