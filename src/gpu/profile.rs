//! Device time of each dispatch.

use super::Context;
use crate::{Error, Result};
use std::collections::BTreeMap;

/// Timestamps around dispatches. Pass it to [`super::Schedule::record_timed`], submit, then read it.
#[derive(Debug)]
pub struct Profile {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    names: Vec<&'static str>,
    capacity: usize,
    period_ns: f64,
}

impl Profile {
    /// Creates a profile of up to 2048 dispatches, the most that one query set holds. `None` if the device
    /// has no timestamps.
    pub fn new(context: &Context) -> Option<Self> {
        if !context.has_timestamps() {
            return None;
        }
        let capacity = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;
        let queries = context.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("profile"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * capacity as u32,
        });
        let resolved = context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("profile"),
            size: 16 * capacity as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let period_ns = f64::from(context.queue.get_timestamp_period());
        Some(Self { queries, resolved, names: Vec::with_capacity(capacity), capacity, period_ns })
    }

    /// Returns the queries for one more dispatch. Dispatches beyond the capacity are not timed.
    pub(super) fn next(&mut self, name: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let at = self.names.len();
        if at == self.capacity {
            return None;
        }
        self.names.push(name);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * at as u32),
            end_of_pass_write_index: Some(2 * at as u32 + 1),
        })
    }

    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if !self.names.is_empty() {
            encoder.resolve_query_set(&self.queries, 0..2 * self.names.len() as u32, &self.resolved, 0);
        }
    }

    /// Waits for the device and returns the milliseconds and the number of dispatches of each kernel, by
    /// name.
    pub fn read(&mut self, context: &Context) -> Result<BTreeMap<&'static str, (f64, usize)>> {
        let size = 16 * self.names.len() as u64;
        let host = context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("profile"),
            size: size.max(16),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        context.submit(|e| e.copy_buffer_to_buffer(&self.resolved, 0, &host, 0, size));
        host.map_async(wgpu::MapMode::Read, .., |_| ());
        context.wait()?;
        let view = host.get_mapped_range(..).map_err(|e| Error::Device(format!("cannot map: {e}")))?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&view[..size as usize]);
        let mut times = BTreeMap::new();
        for (name, t) in self.names.drain(..).zip(ticks.chunks_exact(2)) {
            let (ms, count) = times.entry(name).or_insert((0.0, 0));
            *ms += t[1].saturating_sub(t[0]) as f64 * self.period_ns * 1e-6;
            *count += 1;
        }
        Ok(times)
    }
}
