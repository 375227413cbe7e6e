//! Arrays in device memory.

use super::{Context, Storage};
use crate::{Error, Result};

/// A storage buffer with a shape, holding 32-bit elements or numbers in the network's storage format
/// ([`Storage`]).
///
/// Almost every tensor has a buffer to itself: wgpu refuses to bind one buffer both for reading and for
/// writing, even if the ranges do not overlap. Tensors that are only read together, such as the weights of
/// all layers, may be views of one buffer. So may tensors if every kernel that writes one of them binds them
/// as a whole ([`crate::kernels::optim::Iterate::hidden`]).
#[derive(Clone, Debug)]
pub struct Tensor {
    buffer: wgpu::Buffer,
    /// First byte of the content in the buffer.
    offset: u64,
    shape: Vec<usize>,
    label: &'static str,
    storage: Storage,
    texels: Option<wgpu::TextureView>,
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
        let bytes = (storage.bytes() * shape.iter().product::<usize>().max(1)) as u64;
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
        Ok(Self { buffer, offset: 0, shape: shape.to_vec(), label, storage, texels: None })
    }

    /// Alignment of single-precision views, in elements: every device binds at multiples of 256 bytes.
    pub const VIEW_ALIGNMENT: usize = 64;

    /// Returns the part of this tensor that starts at element `first` and has this shape. It shares the
    /// buffer.
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
        let offset = self.offset + 4 * first as u64;
        Self { buffer: self.buffer.clone(), shape: shape.to_vec(), offset, texels: None, ..*self }
    }

    /// Returns the whole buffer of a single-precision view, and the element at which the view begins. Kernels
    /// that run on many views of one tensor bind it as one, and take the beginning as a parameter.
    pub(crate) fn whole(&self) -> (Self, usize) {
        assert_eq!(self.storage, Storage::F32, "a view of '{}'", self.label);
        let shape = vec![(self.buffer.size() / 4) as usize];
        let whole = Self { buffer: self.buffer.clone(), offset: 0, shape, texels: None, ..*self };
        (whole, (self.offset / 4) as usize)
    }

    /// Returns the first `count` items along the first axis. They share the buffer.
    pub fn first(&self, count: usize) -> Self {
        assert!(count <= self.shape[0], "the first {count} of '{}' {:?}", self.label, self.shape);
        let mut shape = self.shape.clone();
        shape[0] = count;
        Self { buffer: self.buffer.clone(), shape, texels: None, ..*self }
    }

    /// Whether the content can be copied into rows of `width` texels ([`Tensor::with_texels`]): if it is a
    /// whole number of rows, these can be copied from a buffer, and the device has textures as large.
    pub fn fits_texels(&self, context: &Context, width: usize) -> bool {
        let (row, most) = (self.bytes_of_texels(width), context.device.limits().max_texture_dimension_2d);
        let copied = row.is_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT.into());
        let rows = self.bytes() / row.max(1);
        copied && self.bytes() == rows * row && rows.max(width as u64) <= u64::from(most)
    }

    /// Returns the size of this many texels \[bytes\].
    fn bytes_of_texels(&self, count: usize) -> u64 {
        (4 * self.storage.bytes() * count) as u64
    }

    /// Copies the content, as it is when the next submission runs, into a texture that kernels can read
    /// instead of the buffer, in rows of `width` texels of four numbers each.
    ///
    /// Panics if it does not fit ([`Tensor::fits_texels`]).
    pub fn with_texels(&self, context: &Context, width: usize) -> Self {
        assert!(self.fits_texels(context, width), "'{}' in rows of {width} texels", self.label);
        let row = self.bytes_of_texels(width);
        let height = (self.bytes() / row) as u32;
        let size = wgpu::Extent3d { width: width as u32, height, depth_or_array_layers: 1 };
        let texture = context.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(self.label),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: match self.storage {
                Storage::F32 => wgpu::TextureFormat::Rgba32Float,
                Storage::F16 => wgpu::TextureFormat::Rgba16Float,
            },
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let from = wgpu::TexelCopyBufferInfo {
            buffer: &self.buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: self.offset,
                bytes_per_row: Some(row as u32),
                rows_per_image: None,
            },
        };
        context.submit(|encoder| encoder.copy_buffer_to_texture(from, texture.as_image_copy(), size));
        Self { texels: Some(texture.create_view(&wgpu::TextureViewDescriptor::default())), ..self.clone() }
    }

    /// Returns the texture with a copy of the content, if it has one ([`Tensor::with_texels`]).
    pub(super) fn texels(&self) -> Option<&wgpu::TextureView> {
        self.texels.as_ref()
    }

    /// Creates a tensor that holds `data`, whose length must match `shape`.
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

    /// Replaces the whole content, before the next submission runs.
    pub fn write<T: bytemuck::Pod>(&self, context: &Context, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        assert_eq!(bytes.len() as u64, self.bytes(), "tensor '{}' has shape {:?}", self.label, self.shape);
        if !bytes.is_empty() {
            context.queue.write_buffer(&self.buffer, self.offset, bytes);
        }
    }

    /// Replaces the content from element `first` on, before the next submission runs. For single precision
    /// only.
    pub fn write_at(&self, context: &Context, first: usize, data: &[f32]) {
        assert_eq!(self.storage, Storage::F32, "tensor '{}'", self.label);
        assert!(first + data.len() <= self.len(), "tensor '{}' has shape {:?}", self.label, self.shape);
        if !data.is_empty() {
            context.queue.write_buffer(
                &self.buffer,
                self.offset + 4 * first as u64,
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
    /// of a run, not for frames.
    pub fn read<T: bytemuck::Pod>(&self, context: &Context) -> Result<Vec<T>> {
        // On a lost device the buffer would be invalid, and mapping it panics.
        let mut readback = super::Readback::new(context, &[self], 1)?;
        let submission = context.submit(|encoder| readback.record(encoder));
        readback.submitted(&submission);
        let content = readback.next(context, bytemuck::pod_collect_to_vec)?;
        Ok(content.expect("one read is under way"))
    }

    /// Returns the buffer, usable for storage, as a vertex buffer and for copies. The content starts at
    /// [`Tensor::offset`].
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Returns the first byte of the content in the buffer: 0 unless the tensor is a view.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Returns the resource that a kernel binds, whether of this crate or another: the content, rounded up to
    /// whole vec4s.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        let size = self.bytes().max(4).next_multiple_of(16);
        let size = std::num::NonZeroU64::new(size.min(self.buffer.size() - self.offset));
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: &self.buffer, offset: self.offset, size })
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
