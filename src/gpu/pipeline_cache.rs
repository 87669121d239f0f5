//! Compiled pipelines, kept from run to run where the backend can export them, so that a driver need not compile them
//! again. Most drivers also have a cache of their own.
//!
//! Must not know: where the data is stored.

use twox_hash::XxHash3_128;
use wgpu::{AdapterInfo, Device, Features, PipelineCacheDescriptor};

use crate::gpu::processor;

/// Size of the hash in front of the cached data, bytes.
const HASH_BYTES: usize = size_of::<u128>();

/// The pipeline cache of a device, with what is needed to store it between runs.
#[derive(Debug)]
pub struct PipelineCache {
    /// Name to store the data under: that of a file, of letters, digits, `-` and `_`.
    pub key: String,
    cache: wgpu::PipelineCache,
    /// The stored data that the cache was created from, hash included.
    stored: Option<Vec<u8>>,
}

impl PipelineCache {
    /// The cache of a device; `None` if its backend cannot export one. `load` gets a key and returns the data stored
    /// under it. Data that is damaged, or from another driver, is ignored.
    pub(super) fn new(
        device: &Device,
        info: &AdapterInfo,
        load: impl FnOnce(&str) -> Option<Vec<u8>>,
    ) -> Option<Self> {
        if !device.features().contains(Features::PIPELINE_CACHE) {
            return None;
        }
        let key = key(info, processor::description())?;
        let stored = load(&key);
        let cache = create(device, stored.as_deref().and_then(without_hash));
        Some(Self { key, cache, stored })
    }

    /// The handle to create pipelines with.
    #[must_use]
    pub const fn handle(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    /// Data to store under [`Self::key`]; `None` if it has not changed since it was loaded.
    #[must_use]
    pub fn changed_data(&self) -> Option<Vec<u8>> {
        let data = with_hash(&self.cache.get_data()?);
        (self.stored.as_ref() != Some(&data)).then_some(data)
    }
}

/// The name of a cache: kind of adapter, build of its driver, processor, version of this crate. A software adapter compiles for
/// the processor, and several machines may share a home folder. `None` for a backend without caches.
fn key(info: &AdapterInfo, processor: &str) -> Option<String> {
    let adapter = wgpu::util::pipeline_cache_key(info)?;
    let machine = [&info.name, &info.driver, &info.driver_info, processor].join("\n");
    let hash = XxHash3_128::oneshot(machine.as_bytes()) as u64;
    Some(format!("{adapter}-{hash:016x}-{}", env!("CARGO_PKG_VERSION")))
}

#[expect(unsafe_code, reason = "wgpu has no safe way to create a cache from data; see SAFETY")]
fn create(device: &Device, data: Option<&[u8]>) -> wgpu::PipelineCache {
    let descriptor = PipelineCacheDescriptor { label: Some("pipeline_cache"), data, fallback: true };
    // SAFETY: the data came from `PipelineCache::get_data`: `without_hash` rejects whatever does not match the hash that
    // was stored with it. wgpu checks that it belongs to this kind of adapter and this build of its driver.
    unsafe { device.create_pipeline_cache(&descriptor) }
}

/// The hash of the data, then the data.
fn with_hash(data: &[u8]) -> Vec<u8> {
    [&XxHash3_128::oneshot(data).to_le_bytes(), data].concat()
}

/// The data behind the hash, if it matches the hash.
fn without_hash(stored: &[u8]) -> Option<&[u8]> {
    let (hash, data) = stored.split_first_chunk::<HASH_BYTES>()?;
    (u128::from_le_bytes(*hash) == XxHash3_128::oneshot(data)).then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Gpu;
    use crate::gpu::adapter::adapter_of_tests;

    #[test]
    fn damaged_data_never_reaches_a_driver() {
        let data = b"pipelines of some driver";
        let stored = with_hash(data);
        assert_eq!(without_hash(&stored), Some(&data[..]));
        for end in 0..stored.len() {
            assert_eq!(without_hash(&stored[..end]), None, "cut after {end}");
        }
        for index in 0..stored.len() {
            let mut damaged = stored.clone();
            damaged[index] ^= 1;
            assert_eq!(without_hash(&damaged), None, "damaged at {index}");
        }
    }

    #[test]
    fn drivers_and_processors_do_not_share_a_cache() {
        let info = Gpu::open(Some(&adapter_of_tests())).expect("a device").info;
        let updated = AdapterInfo { driver_info: format!("{} (git)", info.driver_info), ..info.clone() };
        let wider = AdapterInfo { name: format!("{}, 512 bits", info.name), ..info.clone() };
        let keys = [(&info, "fma avx2"), (&info, "sse4.2"), (&updated, "fma avx2"), (&wider, "fma avx2")]
            .map(|(info, processor)| key(info, processor).expect("a key"));
        let distinct: std::collections::BTreeSet<_> = keys.iter().collect();
        assert_eq!(distinct.len(), keys.len(), "{keys:?}");
        assert_eq!(key(&info, "sse4.2").as_ref(), Some(&keys[1]));
    }

    #[test]
    fn a_driver_reuses_its_own_data_and_survives_any_other() {
        let open = |stored: Option<Vec<u8>>| {
            let gpu = Gpu::open_with_cache(Some(&adapter_of_tests()), |_| stored).expect("a device");
            let data = gpu.pipeline_cache().and_then(wgpu::PipelineCache::get_data);
            gpu.check().expect("no pending error");
            data.expect("the driver exports its cache")
        };
        let exported = open(None);
        assert_eq!(open(Some(with_hash(&exported))), exported);
        assert_eq!(open(Some(exported.clone())), exported, "without its hash");
        assert_eq!(open(Some(with_hash(b"data of another driver"))), exported);
    }
}
