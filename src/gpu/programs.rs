//! Compiled programs, kept from run to run where the backend gives them out: a driver then need not compile them again.
//! Most drivers keep their own besides.
//!
//! Must not know: where they are kept.

use twox_hash::XxHash3_128;
use wgpu::{AdapterInfo, Device, Features, PipelineCache, PipelineCacheDescriptor};

/// Bytes of the hash before the programs.
const HASH_BYTES: usize = size_of::<u128>();

/// The compiled programs of a device.
#[derive(Debug)]
pub struct Programs {
    /// What they are kept under: kind of adapter and version of this program.
    pub key: String,
    cache: PipelineCache,
    /// What was kept of them before.
    kept: Option<Vec<u8>>,
}

impl Programs {
    /// Those of a device, unless its backend gives none out. `kept` gives what was kept under a key; what is not whole, or another
    /// driver's, is left aside.
    pub(super) fn new(
        device: &Device,
        info: &AdapterInfo,
        kept: impl FnOnce(&str) -> Option<Vec<u8>>,
    ) -> Option<Self> {
        if !device.features().contains(Features::PIPELINE_CACHE) {
            return None;
        }
        let key = format!("{}-{}", wgpu::util::pipeline_cache_key(info)?, env!("CARGO_PKG_VERSION"));
        let kept = kept(&key);
        let cache = create(device, kept.as_deref().and_then(unsealed));
        Some(Self { key, cache, kept })
    }

    /// What pipelines are made with.
    #[must_use]
    pub const fn cache(&self) -> &PipelineCache {
        &self.cache
    }

    /// What to keep under [`Self::key`], unless it is what was kept before.
    #[must_use]
    pub fn to_keep(&self) -> Option<Vec<u8>> {
        let sealed = sealed(&self.cache.get_data()?);
        (self.kept.as_ref() != Some(&sealed)).then_some(sealed)
    }
}

#[expect(unsafe_code, reason = "there is no other way to give a driver what it gave; see SAFETY")]
fn create(device: &Device, data: Option<&[u8]>) -> PipelineCache {
    let descriptor = PipelineCacheDescriptor { label: Some("programs"), data, fallback: true };
    // SAFETY: the data is what `PipelineCache::get_data` gave: `unsealed` lets nothing pass whose hash is another than the one that was
    // put before it then. wgpu sees to it that it came from this kind of adapter and this build of its driver.
    unsafe { device.create_pipeline_cache(&descriptor) }
}

/// Data behind its hash.
fn sealed(data: &[u8]) -> Vec<u8> {
    [&XxHash3_128::oneshot(data).to_le_bytes(), data].concat()
}

/// The data, if it is whole.
fn unsealed(kept: &[u8]) -> Option<&[u8]> {
    let (hash, data) = kept.split_first_chunk::<HASH_BYTES>()?;
    (u128::from_le_bytes(*hash) == XxHash3_128::oneshot(data)).then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_whole_is_given_to_a_driver() {
        let data = b"programs of some driver";
        let kept = sealed(data);
        assert_eq!(unsealed(&kept), Some(&data[..]));
        for end in 0..kept.len() {
            assert_eq!(unsealed(&kept[..end]), None, "cut after {end}");
        }
        for place in 0..kept.len() {
            let mut damaged = kept.clone();
            damaged[place] ^= 1;
            assert_eq!(unsealed(&damaged), None, "damaged at {place}");
        }
    }
    #[test]
    fn a_driver_takes_back_what_it_gave_and_is_spared_the_rest() {
        let open = |kept: Option<Vec<u8>>| {
            let gpu = crate::gpu::Gpu::open_with(Some("cpu"), |_| kept).expect("a device");
            let data = gpu.programs.as_ref().and_then(|programs| programs.cache().get_data());
            gpu.check().expect("nothing is wrong");
            data.expect("the CPU driver gives programs out")
        };
        let given = open(None);
        assert_eq!(open(Some(sealed(&given))), given);
        assert_eq!(open(Some(given.clone())), given, "without its hash");
        assert_eq!(open(Some(sealed(b"another driver's"))), given);
    }
}
