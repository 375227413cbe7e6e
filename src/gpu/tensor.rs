//! Arrays in device memory.

use super::{Context, Storage};
use crate::{Error, Result};

/// An array with a shape, of 32-bit elements or numbers in the network's storage format ([`Storage`]), in a
/// storage buffer or, for some kernels on some adapters, in the texels of a texture.
///
/// Almost every tensor has a buffer to itself: wgpu refuses to bind one buffer both for reading and for
/// writing, even if the ranges do not overlap. Tensors that are only read together, such as the weights of
/// all layers, may be views of one buffer. So may tensors if every kernel that writes one of them binds them
/// as a whole ([`crate::kernels::optim::Iterate::hidden`]).
#[derive(Clone, Debug)]
pub struct Tensor {
    memory: Memory,
    shape: Vec<usize>,
    label: &'static str,
    storage: Storage,
}

/// Where a tensor is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Memory {
    Buffer {
        buffer: wgpu::Buffer,
        /// First byte of the content.
        offset: u64,
    },
    /// Four numbers to a texel, which number along rows of [`Tensor::TEXELS`].
    Texels(wgpu::TextureView),
}

impl Tensor {
    /// Creates a tensor of zeros. Fails if it exceeds the largest binding of the device.
    pub fn zeros(context: &Context, label: &'static str, shape: &[usize]) -> Result<Self> {
        Self::zeros_of(context, label, shape, Storage::F32)
    }

    /// Creates a tensor of zeros in the storage format of the context's networks. Fails like
    /// [`Tensor::zeros`].
    pub fn stored_zeros(context: &Context, label: &'static str, shape: &[usize]) -> Result<Self> {
        Self::zeros_of(context, label, shape, context.storage())
    }

    fn zeros_of(context: &Context, label: &'static str, shape: &[usize], storage: Storage) -> Result<Self> {
        // Beyond any device, whatever it would wrap to.
        let elements = shape.iter().fold(1usize, |product, &length| product.saturating_mul(length));
        let bytes = elements.max(1).saturating_mul(storage.bytes()) as u64;
        let most = context.largest_binding();
        if bytes > most {
            return Err(Error::Device(format!(
                "{}: tensor '{label}' of shape {shape:?} needs {bytes} bytes, the device binds at most {most}",
                context.name()
            )));
        }
        let buffer = context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            // A multiple of 16 bytes, so that any tensor can be read as an array of vec4.
            size: bytes.next_multiple_of(16),
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::UNIFORM
                | wgpu::BufferUsages::COPY_SRC
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::VERTEX,
            mapped_at_creation: false,
        });
        // Otherwise wgpu clears it before its first use, and until then checks for that in every dispatch
        // that binds it.
        context.submit(|encoder| encoder.clear_buffer(&buffer, 0, None));
        let memory = Memory::Buffer { buffer, offset: 0 };
        Ok(Self { memory, shape: shape.to_vec(), label, storage })
    }

    /// Alignment of single-precision views, in elements: every device binds at multiples of 256 bytes.
    pub const VIEW_ALIGNMENT: usize = 64;

    /// Returns the part of this tensor that starts at element `first` and has this shape. It shares the
    /// buffer. Panics if `first` is not a multiple of [`Tensor::VIEW_ALIGNMENT`], if the part leaves the
    /// tensor, or if the tensor is not in single precision.
    ///
    /// A kernel that reads the view as vec4 sees its length rounded up to a multiple of four elements.
    pub fn view(&self, first: usize, shape: &[usize]) -> Self {
        assert_eq!(first % Self::VIEW_ALIGNMENT, 0, "a view of '{}' starts at element {first}", self.label);
        assert!(
            first + shape.iter().product::<usize>() <= self.len(),
            "a view of '{}' leaves it",
            self.label
        );
        assert_eq!(self.storage, Storage::F32, "a view of '{}'", self.label);
        let memory =
            Memory::Buffer { buffer: self.buffer().clone(), offset: self.offset() + 4 * first as u64 };
        Self { memory, shape: shape.to_vec(), ..*self }
    }

    /// Returns the whole buffer of a single-precision view, and the element at which the view begins. Kernels
    /// that run on many views of one tensor bind it as one, and take the beginning as a parameter.
    pub(crate) fn whole(&self) -> (Self, usize) {
        assert_eq!(self.storage, Storage::F32, "a view of '{}'", self.label);
        let shape = vec![(self.buffer().size() / 4) as usize];
        let memory = Memory::Buffer { buffer: self.buffer().clone(), offset: 0 };
        (Self { memory, shape, ..*self }, (self.offset() / 4) as usize)
    }

    /// Returns the first `count` items along the first axis. They share the memory. Panics if there are fewer.
    pub fn first(&self, count: usize) -> Self {
        assert!(count <= self.shape[0], "the first {count} of '{}' {:?}", self.label, self.shape);
        let mut shape = self.shape.clone();
        shape[0] = count;
        Self { memory: self.memory.clone(), shape, ..*self }
    }

    /// Number of texels in a row of a texture, as in `shaders/common/texel.wgsl`.
    pub const TEXELS: u32 = 4096;

    /// Whether the device has textures for this many numbers.
    pub fn fits_texels(context: &Context, len: usize) -> bool {
        let most = context.device.limits().max_texture_dimension_2d;
        Self::TEXELS <= most && len.div_ceil(4 * Self::TEXELS as usize) <= most as usize
    }

    /// Creates a tensor in texels, in the storage format of the context's networks. Kernels declare such a
    /// tensor as a texture, and number its quads with `shaders/common/texel.wgsl`. Its content is undefined.
    ///
    /// Panics if it does not fit the device's textures ([`Tensor::fits_texels`]).
    pub fn texels(context: &Context, label: &'static str, shape: &[usize]) -> Self {
        Self::texels_of(context, label, shape, context.storage())
    }

    fn texels_of(context: &Context, label: &'static str, shape: &[usize], storage: Storage) -> Self {
        let len: usize = shape.iter().product();
        assert!(Self::fits_texels(context, len), "'{label}' of shape {shape:?} in texels");
        let texture = context.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d {
                width: Self::TEXELS,
                height: len.div_ceil(4 * Self::TEXELS as usize).max(1) as u32,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: storage.texels(),
            usage: wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let memory = Memory::Texels(texture.create_view(&wgpu::TextureViewDescriptor::default()));
        Self { memory, shape: shape.to_vec(), label, storage }
    }

    /// Returns a copy in texels of the content that the next submission finds.
    ///
    /// Panics if it does not fit the device's textures ([`Tensor::fits_texels`]).
    pub fn to_texels(&self, context: &Context) -> Self {
        let copy = Self::texels_of(context, self.label, &self.shape, self.storage);
        let Memory::Texels(view) = &copy.memory else { unreachable!("made of texels") };
        let row = 4 * self.storage.bytes() as u32 * Self::TEXELS;
        let all = self.len().div_ceil(4) as u32;
        // Whole rows, then the rest.
        let (rows, rest) = (all / Self::TEXELS, all % Self::TEXELS);
        let parts = [(0, Self::TEXELS, rows), (rows, rest, 1)];
        context.submit(|encoder| {
            for (first, width, height) in parts.into_iter().filter(|&(_, width, height)| width * height > 0) {
                let from = wgpu::TexelCopyBufferInfo {
                    buffer: self.buffer(),
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: self.offset() + u64::from(first) * u64::from(row),
                        bytes_per_row: Some(row),
                        rows_per_image: None,
                    },
                };
                let to = wgpu::TexelCopyTextureInfo {
                    origin: wgpu::Origin3d { x: 0, y: first, z: 0 },
                    ..view.texture().as_image_copy()
                };
                let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
                encoder.copy_buffer_to_texture(from, to, size);
            }
        });
        copy
    }

    /// Creates a tensor that holds `data`. Fails like [`Tensor::zeros`]. Panics if the length does not match
    /// `shape`.
    pub fn from_slice<T: bytemuck::Pod>(
        context: &Context,
        label: &'static str,
        shape: &[usize],
        data: &[T],
    ) -> Result<Self> {
        let tensor = Self::zeros(context, label, shape)?;
        tensor.write(context, data);
        Ok(tensor)
    }

    /// Replaces the whole content, before the next submission runs. Panics on another length, and on a texture.
    pub fn write<T: bytemuck::Pod>(&self, context: &Context, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        assert_eq!(bytes.len() as u64, self.bytes(), "tensor '{}' has shape {:?}", self.label, self.shape);
        if !bytes.is_empty() {
            context.queue.write_buffer(self.buffer(), self.offset(), bytes);
        }
    }

    /// Replaces the content from element `first` on, before the next submission runs. Panics if `data` reaches
    /// past the end, or if the tensor is not in single precision.
    pub fn write_at(&self, context: &Context, first: usize, data: &[f32]) {
        assert_eq!(self.storage, Storage::F32, "tensor '{}'", self.label);
        assert!(first + data.len() <= self.len(), "tensor '{}' has shape {:?}", self.label, self.shape);
        if !data.is_empty() {
            context.queue.write_buffer(
                self.buffer(),
                self.offset() + 4 * first as u64,
                bytemuck::cast_slice(data),
            );
        }
    }

    /// Replaces the whole content with these numbers, narrowed to the tensor's storage format.
    pub fn write_narrowed(&self, context: &Context, data: &[f32]) {
        match self.storage {
            Storage::F32 => self.write(context, data),
            Storage::F16 => {
                let narrow: Vec<u16> = data.iter().map(|&v| half::f16::from_f32(v).to_bits()).collect();
                self.write(context, &narrow);
            }
        }
    }

    /// Reads the whole content, widened from the tensor's storage format. Waits like [`Tensor::read`].
    pub fn read_widened(&self, context: &Context) -> Result<Vec<f32>> {
        match self.storage {
            Storage::F32 => self.read(context),
            Storage::F16 => {
                let narrow: Vec<u16> = self.read(context)?;
                Ok(narrow.into_iter().map(|bits| half::f16::from_bits(bits).to_f32()).collect())
            }
        }
    }

    /// Returns the storage format of its numbers.
    pub fn storage(&self) -> Storage {
        self.storage
    }

    /// Reads the whole content, waiting for everything submitted so far. For tests and for the start and end
    /// of a run, not for frames. Fails if the device is lost. Panics on a texture.
    pub fn read<T: bytemuck::Pod>(&self, context: &Context) -> Result<Vec<T>> {
        let mut readback = super::Readback::new(context, &[self], 1)?;
        let submission = context.submit(|encoder| readback.record(encoder));
        readback.submitted(&submission);
        let content = readback.next(bytemuck::pod_collect_to_vec)?;
        Ok(content.expect("one read is under way"))
    }

    /// Returns the buffer, usable for storage, as a vertex buffer and for copies. The content starts at
    /// [`Tensor::offset`].
    ///
    /// Panics if the tensor is in texels.
    pub fn buffer(&self) -> &wgpu::Buffer {
        match &self.memory {
            Memory::Buffer { buffer, .. } => buffer,
            Memory::Texels(_) => panic!("tensor '{}' is in texels", self.label),
        }
    }

    /// Returns the first byte of the content in the buffer: 0 unless the tensor is a view.
    pub fn offset(&self) -> u64 {
        match self.memory {
            Memory::Buffer { offset, .. } => offset,
            Memory::Texels(_) => 0,
        }
    }

    pub(super) fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Returns the resource that a kernel binds, whether of this crate or another: the content, rounded up to
    /// whole vec4s, or all texels.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        match &self.memory {
            Memory::Buffer { buffer, offset } => {
                let size = self.bytes().max(4).next_multiple_of(16);
                let size = std::num::NonZeroU64::new(size.min(buffer.size() - offset));
                wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: *offset, size })
            }
            Memory::Texels(view) => wgpu::BindingResource::TextureView(view),
        }
    }

    /// Returns the number of elements along each axis.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether it has no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the size of the content in bytes.
    pub fn bytes(&self) -> u64 {
        (self.storage.bytes() * self.len()) as u64
    }

    /// Returns the name given at creation.
    pub fn label(&self) -> &'static str {
        self.label
    }
}
