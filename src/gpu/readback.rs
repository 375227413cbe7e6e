//! From the device to the host, without stalling the queue.

use super::{Context, Tensor};
use crate::{Error, Result};
use futures::channel::oneshot::{self, Canceled};
use std::collections::VecDeque;

type Mapping = Result<(), wgpu::BufferAsyncError>;

/// A ring of host-visible buffers, each of which takes a copy of the same tensors.
///
/// A frame is recorded with [`Readback::record`] into the encoder that computes it; after the submission
/// [`Readback::submitted`] starts the mapping, and [`Readback::next`] hands out the results in order, or
/// [`Readback::try_next`] what has arrived. With two slots or more the device computes a frame while the host reads the one
/// before it.
#[derive(Debug)]
pub struct Readback {
    sources: Vec<Tensor>,
    free: Vec<wgpu::Buffer>,
    recorded: Vec<wgpu::Buffer>,
    under_way: VecDeque<(wgpu::Buffer, oneshot::Receiver<Mapping>, wgpu::SubmissionIndex)>,
    bytes: u64,
}

impl Readback {
    /// A ring of `depth` slots for the concatenated contents of `sources`.
    pub fn new(context: &Context, sources: &[&Tensor], depth: usize) -> Self {
        let bytes: u64 = sources.iter().map(|t| t.bytes()).sum();
        let slot = || {
            context.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes.max(4),
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            })
        };
        let free = (0..depth).map(|_| slot()).collect();
        let sources = sources.iter().map(|&t| t.clone()).collect();
        Self { sources, free, recorded: Vec::new(), under_way: VecDeque::new(), bytes }
    }

    /// Records the copies into a free slot. Panics when all slots are under way ([`Readback::is_full`]): take one with
    /// [`Readback::next`] first.
    pub fn record(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let slot = self.free.pop().expect("a slot of the ring is free");
        let mut offset = 0;
        for source in &self.sources {
            encoder.copy_buffer_to_buffer(source.buffer(), source.offset(), &slot, offset, source.bytes());
            offset += source.bytes();
        }
        self.recorded.push(slot);
    }

    /// Forgets what was recorded into an encoder that is dropped instead of submitted.
    pub fn discard(&mut self) {
        self.free.append(&mut self.recorded);
    }

    /// Starts mapping what was recorded; call it after the encoder was submitted, with what the queue returned.
    pub fn submitted(&mut self, submission: &wgpu::SubmissionIndex) {
        for slot in self.recorded.drain(..) {
            let (done, mapped) = oneshot::channel();
            // A receiver that is gone means that the ring was dropped: nothing is left to tell.
            slot.map_async(wgpu::MapMode::Read, .., move |r| drop(done.send(r)));
            self.under_way.push_back((slot, mapped, submission.clone()));
        }
    }

    /// Whether every slot is under way.
    pub fn is_full(&self) -> bool {
        self.free.is_empty()
    }

    /// What `read` makes of the bytes of the oldest result, waiting for it if need be; `None` when nothing is under way.
    pub fn next<T>(&mut self, context: &Context, read: impl FnOnce(&[u8]) -> T) -> Result<Option<T>> {
        let Some((_, _, submission)) = self.under_way.front() else { return Ok(None) };
        // Wait for this submission and no longer: later ones may still be computing.
        let poll = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: None };
        context.poll(poll)?;
        let (slot, mapped, _) = self.under_way.pop_front().expect("the oldest is there");
        self.take(context, slot, pollster::block_on(mapped), read).map(Some)
    }

    /// As [`Readback::next`] without waiting: `None` as well while the oldest result has not arrived.
    pub fn try_next<T>(&mut self, context: &Context, read: impl FnOnce(&[u8]) -> T) -> Result<Option<T>> {
        context.poll(wgpu::PollType::Poll)?;
        let Some((_, mapped, _)) = self.under_way.front_mut() else { return Ok(None) };
        let Some(mapping) = mapped.try_recv().transpose() else { return Ok(None) };
        let (slot, ..) = self.under_way.pop_front().expect("the oldest is there");
        self.take(context, slot, mapping, read).map(Some)
    }

    /// What `read` makes of a slot that was mapped. The slot is free then, whatever comes of it.
    fn take<T>(
        &mut self,
        context: &Context,
        slot: wgpu::Buffer,
        mapping: Result<Mapping, Canceled>,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        let mapped = mapping.map_err(|e| e.to_string()).and_then(|mapped| mapped.map_err(|e| e.to_string()));
        let made = mapped.and_then(|()| {
            let view = slot.get_mapped_range(..).map_err(|e| e.to_string())?;
            let made = read(&view[..self.bytes as usize]);
            drop(view);
            slot.unmap();
            Ok(made)
        });
        self.free.push(slot);
        made.map_err(|e| Error::Lost(format!("{}: cannot read back: {e}", context.name())))
    }
}
