//! Data about an adapter that outlasts the process, in files in the user's cache directory.

use super::Context;
use crate::{Result, io};
use etcetera::base_strategy::{BaseStrategy, choose_native_strategy};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Environment variable that names the cache folder, overriding the user's cache directory.
pub(crate) const CACHE_FOLDER: &str = "FNOPT_CACHE";

/// Largest size of a pipeline file \[bytes\]. Unused pipelines cannot be removed from a cache, so a larger
/// file is discarded and started afresh.
const MOST: usize = 64 << 20;

/// The device's pipeline cache, and how much of it is in its file.
#[derive(Debug)]
pub(super) struct PipelineCache {
    pub raw: wgpu::PipelineCache,
    path: PathBuf,
    /// Size of the data that the driver accepted from the file, or that was last stored there \[bytes\].
    kept: AtomicUsize,
}

impl Context {
    /// Returns the path of the file that holds `what` for this adapter: in the folder named by `FNOPT_CACHE`,
    /// or else in `fnopt` in the user's cache directory. `None` if there is no such directory. The file name
    /// identifies the adapter, its driver and the version of this package; builds of one version share the
    /// file.
    pub(crate) fn cache_file(&self, what: &str, extension: &str) -> Option<PathBuf> {
        let folder = match std::env::var_os(CACHE_FOLDER).filter(|folder| !folder.is_empty()) {
            Some(folder) => PathBuf::from(folder),
            None => choose_native_strategy().ok()?.cache_dir().join("fnopt"),
        };
        Some(folder.join(format!("{what}_{:08x}.{extension}", self.stamp().finalize())))
    }

    /// Returns a checksum fed with the adapter, its driver and the version of this package.
    fn stamp(&self) -> crc32fast::Hasher {
        let mut sum = crc32fast::Hasher::new();
        sum.update(self.name().as_bytes());
        sum.update(env!("CARGO_PKG_VERSION").as_bytes());
        sum
    }

    /// Returns the same device, which compiles kernels with the help of the pipelines that
    /// [`Context::store_pipelines`] left in the adapter's file. A file that is damaged or belongs to
    /// something else is ignored with a warning. Nothing changes if the device was created without
    /// [`wgpu::Features::PIPELINE_CACHE`] ([`Context::headless`] requests it), or if there is no cache
    /// directory.
    ///
    /// The driver trusts the file: if `FNOPT_CACHE` names a folder, only the user should be able to write to
    /// it.
    ///
    /// Fails if the device is out of memory.
    pub fn with_stored_pipelines(&self) -> Result<Self> {
        let has_cache = self.device.features().contains(wgpu::Features::PIPELINE_CACHE);
        let Some(path) = self.cache_file("pipelines", "bin").filter(|_| has_cache) else {
            return Ok(self.clone());
        };
        let stored = self.stored_pipelines(&path);
        let raw = self.checked(|| Ok(create(&self.device, stored.as_deref())))?;
        // The driver may ignore the data it is given; the file is then due to be replaced.
        let kept = stored.and_then(|_| raw.get_data()).map_or(0, |data| data.len());
        tracing::info!("pipeline cache: {}, {kept} bytes", path.display());
        let mut context = self.clone();
        context.pipelines = Some(Arc::new(PipelineCache { raw, path, kept: kept.into() }));
        Ok(context)
    }

    /// Stores the pipelines compiled so far, where [`Context::with_stored_pipelines`] will find them. Returns
    /// the path of the file, or `None` if the device has no cache or there was nothing to add to the file. If
    /// several processes store their pipelines, the last one wins. Fails if the file cannot be written.
    pub fn store_pipelines(&self) -> Result<Option<PathBuf>> {
        let Some(cache) = &self.pipelines else { return Ok(None) };
        let data = cache.raw.get_data().unwrap_or_default();
        if data.len() <= cache.kept.load(Ordering::Relaxed) {
            return Ok(None);
        }
        io::write_atomic(&cache.path, |file| {
            file.write_all(&data)?;
            file.write_all(&self.seal(&data))
        })?;
        cache.kept.store(data.len(), Ordering::Relaxed);
        Ok(Some(cache.path.clone()))
    }

    /// Reads the data that [`Context::store_pipelines`] wrote to a file. `None` if the file is missing,
    /// damaged, too large or belongs to something else.
    fn stored_pipelines(&self, path: &Path) -> Option<Vec<u8>> {
        let mut bytes = std::fs::read(path).ok()?;
        if bytes.len() > MOST {
            tracing::info!("{}: larger than {} MiB; starting a new one", path.display(), MOST >> 20);
            return None;
        }
        match bytes.split_last_chunk() {
            Some((data, seal)) if *seal == self.seal(data) => {
                bytes.truncate(data.len());
                Some(bytes)
            }
            _ => {
                tracing::warn!(
                    "{}: not a pipeline cache of {}; compiling again",
                    path.display(),
                    self.name()
                );
                None
            }
        }
    }

    /// Returns the checksum that ends a pipeline file. It shows that the data is complete and belongs to this
    /// very adapter.
    fn seal(&self, data: &[u8]) -> [u8; 4] {
        let mut sum = self.stamp();
        sum.update(
            wgpu::util::pipeline_cache_key(&self.device.adapter_info()).unwrap_or_default().as_bytes(),
        );
        sum.update(data);
        sum.finalize().to_le_bytes()
    }

    /// Returns the pipeline cache, if there is one.
    pub(super) fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.pipelines.as_ref().map(|cache| &cache.raw)
    }
}

/// Creates a pipeline cache from the data returned by [`Context::stored_pipelines`].
#[allow(unsafe_code, reason = "one of three exceptions; see SAFETY")]
fn create(device: &wgpu::Device, data: Option<&[u8]>) -> wgpu::PipelineCache {
    let descriptor = wgpu::PipelineCacheDescriptor { label: Some("fnopt"), data, fallback: true };
    // SAFETY: the data must come from `wgpu::PipelineCache::get_data`. It does: `Context::store_pipelines`
    // wrote it, and its seal has been checked against the data, the adapter, the driver and the version of
    // this package, so it is neither truncated, nor altered, nor from another device. In addition, wgpu
    // compares backend, vendor, device and driver version, and the driver checks its own header, before they
    // use it. Only someone who forges a file in the user's own cache directory gets past that.
    unsafe { device.create_pipeline_cache(&descriptor) }
}
