//! A picture without a window.

use super::Viewer;
use crate::gpu::{Context, Tensor};
use crate::render::Image;
use crate::{Error, Result};
use std::time::Duration;

/// The format of pictures that are not those of a window: the shaders encode colours themselves.
pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Rows of a picture are copied to a multiple of so many bytes.
const ROW: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// A picture that a viewer draws into in place of a window's, one pixel per point.
pub struct Offscreen {
    context: Context,
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    format: wgpu::TextureFormat,
    time_s: f64,
}

impl Offscreen {
    /// Creates a picture of so many pixels. Fails if the device has no pictures as large, or if a side is 0.
    pub fn new(context: &Context, size: [u32; 2]) -> Result<Self> {
        Self::of_format(context, size, FORMAT)
    }

    pub(super) fn of_format(
        context: &Context,
        [width, height]: [u32; 2],
        format: wgpu::TextureFormat,
    ) -> Result<Self> {
        let most = context.device.limits().max_texture_dimension_2d;
        if ![width, height].iter().all(|side| (1..=most).contains(side)) {
            let expected = format!("sides of 1 to {most} pixels");
            return Err(Error::invalid("view", "size", expected, format!("{width}x{height}")));
        }
        let texture = context.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Ok(Self { context: context.clone(), texture, view, format, time_s: 0.0 })
    }

    /// Returns width and height \[px\].
    pub fn size(&self) -> [u32; 2] {
        [self.texture.width(), self.texture.height()]
    }

    /// Returns what a viewer may draw into.
    pub fn view(&self) -> &wgpu::TextureView {
        &self.view
    }

    /// Has a viewer take these events and draw, `elapsed` after its last picture. Fails as [`Viewer::frame`] does.
    pub fn frame(&mut self, viewer: &mut Viewer, events: Vec<egui::Event>, elapsed: Duration) -> Result<()> {
        self.time_s += elapsed.as_secs_f64();
        let [width, height] = self.size().map(|side| side as f32);
        let input = egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(width, height))),
            time: Some(self.time_s),
            events,
            ..Default::default()
        };
        viewer.frame(input, (&self.view, self.size()), elapsed).map(drop)
    }

    /// Returns the picture. Waits for the device. Fails if it is lost.
    pub fn image(&self) -> Result<Image> {
        let [width, height] = self.size();
        let row = (4 * width).next_multiple_of(ROW);
        let copy = Tensor::zeros(&self.context, "picture", &[height as usize, row as usize / 4])?;
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: copy.buffer(), layout };
        let from = self.texture.as_image_copy();
        self.context.submit(|encoder| encoder.copy_texture_to_buffer(from, to, self.texture.size()));
        let texels: Vec<[u8; 4]> = copy.read(&self.context)?;
        let blue_first = matches!(self.format, wgpu::TextureFormat::Bgra8Unorm);
        let pixel = |[a, g, c, _]: [u8; 4]| if blue_first { [c, g, a] } else { [a, g, c] };
        let rows = texels.chunks_exact(row as usize / 4);
        let pixels = rows.flat_map(|row| row[..width as usize].iter().map(|&texel| pixel(texel))).collect();
        Ok(Image { width: width as usize, height: height as usize, pixels })
    }
}
