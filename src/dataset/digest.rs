//! The digest of a complete dataset: one hash of everything that decides or describes its content.
//!
//! It covers the manifest's identity and every line of `frames.jsonl` but its milliseconds; the lines have the hashes of the
//! frames' files. So it is the same for every run of the same frames, interrupted, sharded or on more threads.
//! Must not know: files, how frames are made.

use serde_json::{Map, Value};
use twox_hash::XxHash3_128;

use crate::error::{Error, Result};
use crate::output::layout::{FrameLine, FrameLines};

/// Key of the digest in a manifest.
pub(super) const KEY: &str = "digest";

/// A digest to which lines are added in ascending order of index.
pub(super) struct Digest(XxHash3_128);

impl Digest {
    /// The digest of a dataset with this identity (see [`Plan::identity`](super::plan::Plan::identity)), without frames.
    pub(super) fn new(identity: &Map<String, Value>) -> Self {
        let mut digest = Self(XxHash3_128::new());
        digest.add_text(&Value::from(identity.clone()).to_string());
        digest
    }

    /// The digest of a dataset with this identity and these lines.
    ///
    /// # Errors
    /// Those of reading.
    pub(super) fn of(identity: &Map<String, Value>, lines: &dyn FrameLines) -> Result<String> {
        let mut digest = Self::new(identity);
        lines.for_each(&mut |line| digest.add(&line))?;
        Ok(digest.to_hex())
    }

    /// Adds a line without its milliseconds.
    ///
    /// # Errors
    /// [`Error::Encode`].
    pub(super) fn add(&mut self, line: &FrameLine) -> Result<()> {
        let line = FrameLine { ms: Map::new(), ..line.clone() };
        let text = serde_json::to_string(&line).map_err(|error| Error::Encode {
            name: "a line of frames.jsonl".to_owned(),
            message: error.to_string(),
        })?;
        self.add_text(&text);
        Ok(())
    }

    fn add_text(&mut self, text: &str) {
        self.0.write(text.as_bytes());
        self.0.write(b"\n");
    }

    /// XXH3, 128 bits, in hexadecimal.
    pub(super) fn to_hex(&self) -> String {
        format!("{:032x}", self.0.finish_128())
    }
}
