//! A sample of frames, made again from the manifest by the code that makes datasets, and compared in every output.
//!
//! Must not know: the folder's other files.

use std::path::Path;

use serde_json::{Value, json};

use super::context::{self, Context, Version};
use super::depth;
use super::differences::differences;
use super::report::{Report, Subject, name};
use super::store::{Archives, StoredFile, files_in, read_hashed};
use super::templates::{ExpectedFile, ExpectedFrame};
use super::tolerance::{self, Agreement};
use crate::dataset::attempt::{Attempt, RenderedFrame, render_attempt, render_frame};
use crate::dataset::log::FrameLog;
use crate::dataset::pipeline::{EncodedFrame, encode_frame};
use crate::error::{Error, Result};
use crate::output::layout::FrameLine;
use crate::render::Renderer;

/// Renders a sample of frames again, spread evenly over the dataset, compares all their outputs with what is stored, and checks
/// their depth. Adds to the report. A sample as large as the dataset takes every frame.
///
/// # Errors
/// Those of reading the manifest and the log; those of a device that no longer works.
pub fn check_rendering(
    folder: &Path,
    renderer: &mut Renderer,
    sample: u64,
    report: &mut Report,
) -> Result<()> {
    let manifest = context::open(folder)?;
    let context = Context::new(folder, &manifest)?;
    if context.version == Version::Other {
        // That is in the report already.
        return Ok(());
    }
    let range = context.plan.range;
    let is_sampled = |index: u64| {
        let offset = u128::from(index - range.start);
        offset * u128::from(sample) % u128::from(range.count) < u128::from(sample)
    };
    let mut number = 0;
    FrameLog::new(folder, context.gate.clone()).for_each_result(&mut |line| {
        number += 1;
        // Lines that cannot be read, and lines of no frame, are already in the report.
        let Ok(line) = line else { return Ok(()) };
        if !(range.start..range.end()).contains(&line.index) || !is_sampled(line.index) {
            return Ok(());
        }
        let mut check = FrameCheck { context: &context, line: &line, number, report };
        match check.run(renderer) {
            Err(error @ (Error::DeviceLost(_) | Error::Device(_) | Error::OutOfMemory)) => Err(error),
            Err(other) => {
                report.problem(name::RENDERING, Subject::Line(line.index), other.to_string());
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    })
}

/// The comparison of one frame.
struct FrameCheck<'a> {
    context: &'a Context<'a>,
    line: &'a FrameLine,
    /// Number of the line in `frames.jsonl`.
    number: u64,
    report: &'a mut Report,
}

impl FrameCheck<'_> {
    /// In what the frame must agree with what a renderer makes of it.
    fn agreement(&self, renderer: &Renderer) -> Agreement {
        let raster = renderer.raster().name();
        let is_same_program =
            self.context.version == Version::Same && self.line.raster.as_deref() == Some(raster);
        match (is_same_program, self.line.adapter == renderer.gpu().info.name) {
            (true, true) => Agreement::Bytes,
            (true, false) if renderer.raster().has_exact_labels() => Agreement::Labels,
            _ => Agreement::Near,
        }
    }

    fn run(&mut self, renderer: &mut Renderer) -> Result<()> {
        let (plan, line) = (&self.context.plan, self.line);
        let agreement = self.agreement(renderer);
        let mut rendered = if agreement == Agreement::Bytes {
            // With all attempts, so that those that were rejected are rejected again.
            render_frame(plan, renderer, line.index)?
        } else if line.attempt < plan.rules.attempts_max {
            // Where a rule is at its limit, another renderer may decide otherwise.
            render_attempt(plan, renderer, &Attempt::known(line.index, line.attempt, line.redrawn.clone()))?
        } else {
            return Ok(());
        };
        let again = encode_frame(plan, &mut rendered)?;
        self.compare_lines(&again.line, agreement);
        self.compare_files(&again, &rendered, agreement, renderer)
    }

    fn compare_lines(&mut self, again: &FrameLine, agreement: Agreement) {
        self.report.look(name::RENDERING);
        // Hashes are compared with the files, and the files with those made again.
        let (ms, hashes) = (self.line.ms.clone(), self.line.hashes.clone());
        let mut expected = json!(FrameLine { ms, hashes, ..again.clone() });
        let mut found = json!(self.line);
        if agreement != Agreement::Bytes {
            tolerance::forgive_record(&mut found, &mut expected);
        }
        for difference in differences(&found, &expected) {
            let found = format!("frames.jsonl, line {}: {}", self.number, difference.text);
            self.report.problem(name::RENDERING, Subject::Line(self.line.index), found);
        }
    }

    fn compare_files(
        &mut self,
        again: &EncodedFrame,
        rendered: &RenderedFrame,
        agreement: Agreement,
        renderer: &mut Renderer,
    ) -> Result<()> {
        let expected = ExpectedFrame::new(&self.context.plan, &self.context.templates, self.line)?;
        let bundle = expected.bundle.as_deref();
        let archives = Archives::open(self.context.folder, bundle.into_iter());
        for artifact in &again.files.artifacts {
            // Files that cannot be read are already in the report.
            let read = read_hashed(self.context, &archives, &expected, self.line.index, &artifact.name);
            let Ok(stored) = read.and_then(|stored| files_in(&expected, stored)) else { continue };
            let made = StoredFile { path: artifact.name.clone(), bytes: artifact.bytes.clone() };
            let made = files_in(&expected, made)?;
            for (name, made) in made {
                let file = expected.files.iter().find(|file| file.path == name);
                let stored = stored.iter().find(|(stored, _)| *stored == name);
                if let (Some(file), Some((_, stored))) = (file, stored) {
                    self.compare_file(file, stored, &made.bytes, agreement);
                    if file.kind.is_some_and(|kind| kind.stem == "distance_to_image_plane") {
                        depth::check_depth(
                            self.context,
                            self.line,
                            stored,
                            &rendered.source.scene,
                            renderer,
                            self.report,
                        )?;
                    }
                }
            }
        }
        Ok(())
    }

    fn compare_file(&mut self, file: &ExpectedFile, stored: &StoredFile, made: &[u8], agreement: Agreement) {
        self.report.look(name::RENDERING);
        if stored.bytes == made {
            return;
        }
        let (path, subject) = (&stored.path, Subject::File(self.line.index));
        let records = [&stored.bytes[..], made].map(serde_json::from_slice::<Value>);
        if let [Ok(mut found), Ok(mut expected)] = records {
            if file.kind.is_some_and(|kind| kind.output == "meta") {
                // Another driver of the same adapter is not a fault; the name is compared with the line.
                tolerance::forgive_driver(&mut found, &mut expected);
            }
            if agreement != Agreement::Bytes {
                tolerance::forgive_record(&mut found, &mut expected);
                tolerance::forgive_rocks(&mut found, &mut expected);
            }
            for difference in differences(&found, &expected) {
                self.report.problem(name::RENDERING, subject, format!("{path}: {}", difference.text));
            }
            return;
        }
        if let Some(found) = tolerance::difference(file, &stored.bytes, made, agreement) {
            self.report.problem(name::RENDERING, subject, format!("{path}: {found}"));
        }
    }
}
