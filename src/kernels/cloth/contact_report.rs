//! Host side of `shaders/cloth/contact_report.wgsl`.

use super::Trial;
use crate::Result;
use crate::cloth::BodyStats;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_report",
    wgsl: include_str!("../../../shaders/cloth/contact_report.wgsl"),
    appended: &[pieces::BODY, terms::CONTACT, pieces::DISPLACED],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    bodies: u32,
}

/// Number of values that the device reports about a body and a cloth.
pub const VALUES: usize = 8;

/// Reports what bodies do.
#[derive(Clone, Debug)]
pub struct ContactReport {
    kernel: Kernel,
}

/// What the device reports about the bodies of one cloth.
#[derive(Clone, Debug, PartialEq)]
pub struct ClothContacts {
    /// One per body.
    pub bodies: Vec<BodyStats>,
    /// The energy of all contacts.
    pub energy: f64,
}

impl ClothContacts {
    /// Returns those of a cloth with so many bodies, read from its part of the report, [count, 8].
    pub fn of(report: &[f32], bodies: usize) -> Self {
        let rows = report.chunks_exact(VALUES).take(bodies);
        let at = |row: &[f32], k: usize| f64::from(row[k]);
        let stats = |row: &[f32]| BodyStats {
            touching: row[0] as usize,
            deepest: at(row, 1),
            load: [at(row, 2), at(row, 3), at(row, 4)],
            friction_work: at(row, 5),
        };
        let energy = rows.clone().map(|row| at(row, 6)).sum();
        Self { bodies: rows.map(stats).collect(), energy }
    }
}

impl ContactReport {
    /// Builds the kernel for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("SLOTS", slots as f64)])? })
    }

    /// Sets `report` [B, count, 8] from the `contacts` [B, slots n, 12] at `iterate.a`, the `bodies` [B, count, 24]
    /// and the `fields` of those that are meshes.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        [contacts, bodies, fields, report]: [&Tensor; 4],
    ) {
        let (n, batch) = (trial.grid.particles(), trial.batch());
        let &[_, count, VALUES] = report.shape() else { panic!("contact_report: {:?}", report.shape()) };
        assert_eq!((report.shape()[0], &bodies.shape()[..2]), (batch, &[batch, count][..]));
        let params = Params { particles: size(n), bodies: size(count) };
        let (given, ..) = &trial.iterate.given();
        let tensors = [contacts, bodies, &trial.iterate.a, given, trial.x, fields, report];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(count), size(batch), 1]);
    }
}
