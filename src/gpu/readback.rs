//! Readback from the device to the host, without stalling the queue.

use super::{Context, Tensor};
use crate::{Error, Result};
use futures::channel::oneshot::{self, Canceled};
use std::collections::VecDeque;

type Mapping = Result<(), wgpu::BufferAsyncError>;

/// A ring of host-visible buffers, each of which takes a copy of the same tensors.
///
/// [`Readback::record`] records the copies into the encoder that computes a frame. After the submission,
/// [`Readback::submitted`] starts the mapping. [`Readback::next`] then returns the results in order, and
/// [`Readback::try_next`] those that have arrived. With two slots or more the device computes a frame while
/// the host reads the previous one.
///
/// ```no_run
/// # fn watch(context: &fnopt::gpu::Context, solver: &fnopt::sim::Solver) -> fnopt::Result<()> {
/// let mut readback = fnopt::gpu::Readback::new(context, &solver.statistics_tensors(), 2)?;
/// loop {
///     let submission = context.submit(|encoder| {
///         solver.record(encoder);
///         if !readback.is_full() {
///             readback.record(encoder);
///         }
///     });
///     readback.submitted(&submission);
///     while let Some(stats) = readback.try_next(|bytes| solver.statistics(bytes))? {
///         assert!(stats.iter().all(|cloth| cloth.is_finite()), "a cloth has diverged");
///     }
/// }
/// # }
/// ```
#[derive(Debug)]
pub struct Readback {
    sources: Vec<Tensor>,
    free: Vec<wgpu::Buffer>,
    recorded: Vec<wgpu::Buffer>,
    in_flight: VecDeque<(wgpu::Buffer, oneshot::Receiver<Mapping>, wgpu::SubmissionIndex)>,
    bytes: u64,
    context: Context,
}

impl Readback {
    /// Creates a ring of `depth` slots for the concatenated contents of `sources`. Fails if there is not
    /// enough memory, or if the device is lost. Panics if `depth` is 0: such a ring is always full.
    pub fn new(context: &Context, sources: &[&Tensor], depth: usize) -> Result<Self> {
        assert!(depth > 0, "a ring of readbacks has at least one slot");
        let bytes: u64 = sources.iter().map(|t| t.bytes()).sum();
        let slot = |_| {
            context.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size: bytes.max(4),
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            })
        };
        let free = context.checked(|| Ok((0..depth).map(slot).collect()))?;
        let sources = sources.iter().map(|&t| t.clone()).collect();
        let context = context.clone();
        Ok(Self { sources, free, recorded: Vec::new(), in_flight: VecDeque::new(), bytes, context })
    }

    /// Records the copies into a free slot. Panics if all slots are in flight ([`Readback::is_full`]): free
    /// one with [`Readback::next`] first.
    pub fn record(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let slot = self.free.pop().expect("a slot of the ring is free");
        let mut offset = 0;
        for source in &self.sources {
            encoder.copy_buffer_to_buffer(source.buffer(), source.offset(), &slot, offset, source.bytes());
            offset += source.bytes();
        }
        self.recorded.push(slot);
    }

    /// Frees the slots that were recorded into an encoder that is dropped instead of submitted.
    pub fn discard(&mut self) {
        self.free.append(&mut self.recorded);
    }

    /// Starts mapping the recorded slots. Call it after submitting the encoder, with the index that the queue
    /// returned.
    pub fn submitted(&mut self, submission: &wgpu::SubmissionIndex) {
        for slot in self.recorded.drain(..) {
            let (done, mapped) = oneshot::channel();
            // If the receiver is gone, the ring was dropped and nobody is left to notify. An error also
            // reaches the receiver.
            let notify = move |mapping| drop(done.send(mapping));
            self.context.unreported(|| slot.map_async(wgpu::MapMode::Read, .., notify));
            self.in_flight.push_back((slot, mapped, submission.clone()));
        }
    }

    /// Whether every slot is in flight.
    pub fn is_full(&self) -> bool {
        self.free.is_empty()
    }

    /// Applies `read` to the bytes of the oldest result and returns its value, waiting for the result if
    /// necessary. `None` if nothing is in flight. Fails if the device is lost. Callbacks of the device's owner
    /// may run here. Not for browsers, in which nothing can wait.
    pub fn next<T>(&mut self, read: impl FnOnce(&[u8]) -> T) -> Result<Option<T>> {
        let Some((_, _, submission)) = self.in_flight.front() else { return Ok(None) };
        // Wait for this submission and no longer: later ones may still be computing.
        let poll = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: None };
        self.context.poll(poll)?;
        let (slot, mapped, _) = self.in_flight.pop_front().expect("the oldest is there");
        self.take(slot, pollster::block_on(mapped), read).map(Some)
    }

    /// As [`Readback::next`], but without waiting: also `None` if the oldest result has not arrived yet.
    pub fn try_next<T>(&mut self, read: impl FnOnce(&[u8]) -> T) -> Result<Option<T>> {
        self.context.poll(wgpu::PollType::Poll)?;
        let Some((_, mapped, _)) = self.in_flight.front_mut() else { return Ok(None) };
        let Some(mapping) = mapped.try_recv().transpose() else { return Ok(None) };
        let (slot, ..) = self.in_flight.pop_front().expect("the oldest is there");
        self.take(slot, mapping, read).map(Some)
    }

    /// Applies `read` to the bytes of a mapped slot, which is free afterwards even on failure.
    fn take<T>(
        &mut self,
        slot: wgpu::Buffer,
        mapping: Result<Mapping, Canceled>,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        let mapped = mapping.map_err(|e| e.to_string()).and_then(|mapped| mapped.map_err(|e| e.to_string()));
        let value = mapped.and_then(|()| {
            let value = slot.get_mapped_range(..).map(|view| read(&view[..self.bytes as usize]));
            // Fails if the device was lost after the copy arrived.
            self.context.unreported(|| slot.unmap());
            value.map_err(|e| e.to_string())
        });
        self.free.push(slot);
        value.map_err(|e| Error::Lost(format!("{}: cannot read back: {e}", self.context.name())))
    }
}
