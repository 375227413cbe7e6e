//! What is kept of an adapter between processes, in files of the user's cache directory.

use super::Context;
use crate::{Result, io};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Variable of the environment that names the folder for what is kept, in place of the user's cache directory.
pub(crate) const CACHE_FOLDER: &str = "FNOPT_CACHE";

/// Most bytes of a file of pipelines. Those that nothing uses any more cannot be taken out of a cache: one that has grown
/// larger is begun anew.
const MOST: usize = 64 << 20;

/// The device's pipeline cache, and how much of it is in its file.
#[derive(Debug)]
pub(super) struct PipelineCache {
    pub raw: wgpu::PipelineCache,
    path: PathBuf,
    /// Bytes that the driver took from the file or that were stored there.
    kept: AtomicUsize,
}

impl Context {
    /// Where `what` of this adapter is kept: in the folder that `FNOPT_CACHE` names, else in `fnopt` of the user's cache
    /// directory. None where there is no such directory. The name stands for the adapter, its driver and the version of this
    /// package: builds of one version share it.
    pub(crate) fn cache_file(&self, what: &str, extension: &str) -> Option<PathBuf> {
        let folder = match std::env::var_os(CACHE_FOLDER) {
            Some(folder) => PathBuf::from(folder),
            None => dirs::cache_dir()?.join("fnopt"),
        };
        Some(folder.join(format!("{what}_{:08x}.{extension}", self.stamp().finalize())))
    }

    /// A checksum that has seen the adapter, its driver and the version of this package.
    fn stamp(&self) -> crc32fast::Hasher {
        let mut sum = crc32fast::Hasher::new();
        sum.update(self.name().as_bytes());
        sum.update(env!("CARGO_PKG_VERSION").as_bytes());
        sum
    }

    /// The same device, for which kernels are compiled with the help of the pipelines that
    /// [`Context::store_pipelines`] left in the adapter's file. One that is damaged or of something else counts as none, and is
    /// said. Nothing changes where the device was made without [`wgpu::Features::PIPELINE_CACHE`] ([`Context::headless`] asks
    /// for it), or where there is no cache directory.
    ///
    /// The driver trusts the file: if `FNOPT_CACHE` names a folder, it should be one that only the user can write to.
    ///
    /// An error where the device has no memory left.
    pub fn with_stored_pipelines(&self) -> Result<Self> {
        let has_cache = self.device.features().contains(wgpu::Features::PIPELINE_CACHE);
        let Some(path) = self.cache_file("pipelines", "bin").filter(|_| has_cache) else {
            return Ok(self.clone());
        };
        let stored = self.stored_pipelines(&path);
        let raw = self.checked(|| Ok(create(&self.device, stored.as_deref())))?;
        // A driver may pass over what it is given, and then the file is due to be replaced.
        let kept = stored.and_then(|_| raw.get_data()).map_or(0, |data| data.len());
        tracing::info!("pipeline cache: {}, {kept} bytes", path.display());
        let mut context = self.clone();
        context.pipelines = Some(Arc::new(PipelineCache { raw, path, kept: kept.into() }));
        Ok(context)
    }

    /// Stores the pipelines that were compiled so far, to be found by [`Context::with_stored_pipelines`] from then on; the file,
    /// if there was something to add to it. The last of several processes leaves its own.
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

    /// What [`Context::store_pipelines`] wrote into a file.
    fn stored_pipelines(&self, path: &Path) -> Option<Vec<u8>> {
        let mut bytes = std::fs::read(path).ok()?;
        if bytes.len() > MOST {
            tracing::info!("{}: more than {} MiB; begun anew", path.display(), MOST >> 20);
            return None;
        }
        match bytes.split_last_chunk() {
            Some((data, seal)) if *seal == self.seal(data) => {
                bytes.truncate(data.len());
                Some(bytes)
            }
            _ => {
                tracing::warn!("{}: no pipelines of {}; they are compiled anew", path.display(), self.name());
                None
            }
        }
    }

    /// The end of a file of pipelines: tells data that is whole and of this very adapter from other data.
    fn seal(&self, data: &[u8]) -> [u8; 4] {
        let mut sum = self.stamp();
        sum.update(
            wgpu::util::pipeline_cache_key(&self.device.adapter_info()).unwrap_or_default().as_bytes(),
        );
        sum.update(data);
        sum.finalize().to_le_bytes()
    }

    /// The pipeline cache, where it was asked for.
    pub(super) fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.pipelines.as_ref().map(|cache| &cache.raw)
    }
}

/// A pipeline cache that begins with the data of [`Context::stored_pipelines`].
#[allow(unsafe_code, reason = "one of three exceptions; see SAFETY")]
fn create(device: &wgpu::Device, data: Option<&[u8]>) -> wgpu::PipelineCache {
    let descriptor = wgpu::PipelineCacheDescriptor { label: Some("fnopt"), data, fallback: true };
    // SAFETY: the data must be what `wgpu::PipelineCache::get_data` returned, and it is what `Context::store_pipelines` wrote of
    // it: its seal was held against the data, the adapter, the driver and the version of this package, so that it is neither cut
    // nor changed nor another device's. Beyond that wgpu compares backend, vendor, device and driver version, and the driver its
    // own header, before they use it. Only whoever forges a file in the user's own cache directory gets past that.
    unsafe { device.create_pipeline_cache(&descriptor) }
}
