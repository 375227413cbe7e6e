//! The objective of a frame on a device.

use super::{
    ClothParams, Curvature, Energy, EnergySum, ExternalForce, ExternalForceTensors, Gradient, Integrate,
    Predict, Repulsion, RepulsionCurvature, StateTensors, TERMS, Trial, energy,
};
use crate::Result;
use crate::cloth::{Grid, Model};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::optim::Iterate;

/// The energy of each cloth of a batch as a function of its accelerations (paper section 3.2): the tensors that it
/// depends on, and the dispatches that evaluate it. [`crate::cpu::Objective`] is its counterpart.
///
/// A frame is [`Objective::begin_frame`], then [`Objective::evaluate`] once for each step of an optimizer, which moves
/// [`Objective::iterate`], then [`Objective::energy`] and [`Objective::end_frame`]. Nothing runs when these are
/// called: they append to a schedule.
#[derive(Clone, Debug)]
pub struct Objective {
    context: Context,
    grid: Grid,
    /// Positions \[edges\], shape [B, 3, n].
    pub x: Tensor,
    /// Velocities [edges / frame], shape [B, 3, n].
    pub v: Tensor,
    /// Wind velocities [edges / frame], shape [B, 3].
    pub wind: Tensor,
    /// Handle targets \[edges\], shape [handles, 3], with as much room as was asked for.
    pub targets: Tensor,
    /// External accelerations set by the caller [edges / frame^2], shape [B, 3, n].
    pub control_accelerations: Tensor,
    /// The unknown, and what an evaluation derives from it.
    pub iterate: Iterate,
    /// Energy terms and stretch, as [`Objective::energy`] leaves them, shape [B, 8]; see
    /// [`ClothTerms`](super::ClothTerms).
    pub terms: Tensor,
    /// Constants of the cloths, shape [B, 16].
    cloths: Tensor,
    /// Parts of the energy, shape [B, parts, 8].
    parts: Tensor,
    external_force: ExternalForce,
    repulsion: Option<(Repulsion, RepulsionCurvature)>,
    gradient: Gradient,
    curvature: Curvature,
    energy: Energy,
    energy_sum: EnergySum,
    integrate: Integrate,
}

/// What an [`Objective`] has room for.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Number of handles, over all cloths.
    pub handles: usize,
    /// Whether cloths may have a repulsion, which costs a search for near particles in every evaluation.
    pub repulsion: bool,
    /// Whether the iterate has the hidden state of a network.
    pub hidden: bool,
}

/// The accelerations from which a frame begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// Zero.
    Zero,
    /// Those that are there.
    Kept,
}

impl Objective {
    /// Builds the kernels and tensors for `batch` cloths on a grid. All tensors are zero, and no particle is held:
    /// [`Objective::set_cloths`] comes before the first frame.
    pub fn new(context: &Context, grid: Grid, batch: usize, room: Room) -> Result<Self> {
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let field = |label| zeros(label, &[batch, 3, grid.particles()]);
        let free = vec![0; batch * grid.particles()];
        let iterate = if room.hidden {
            Iterate::with_hidden(context, batch, &free)
        } else {
            Iterate::new(context, batch, &free)
        }?;
        let repulsion = || -> Result<_> {
            Ok((Repulsion::new(context, batch, grid)?, RepulsionCurvature::new(context)?))
        };
        Ok(Self {
            context: context.clone(),
            grid,
            x: field("positions")?,
            v: field("velocities")?,
            wind: zeros("wind", &[batch, 3])?,
            targets: zeros("handle targets", &[room.handles.max(1), 3])?,
            control_accelerations: field("control accelerations")?,
            iterate: if room.repulsion { iterate.with_total(context)? } else { iterate },
            terms: zeros("energy terms", &[batch, TERMS])?,
            cloths: zeros("cloths", &[batch, ClothParams::LEN])?,
            parts: zeros("energy parts", &energy::parts_shape(batch, grid))?,
            external_force: ExternalForce::new(context)?,
            repulsion: room.repulsion.then(repulsion).transpose()?,
            gradient: Gradient::new(context)?,
            curvature: Curvature::new(context)?,
            energy: Energy::new(context)?,
            energy_sum: EnergySum::new(context)?,
            integrate: Integrate::new(context)?,
        })
    }

    /// Sets the constants and handles of the cloths, ahead of the next submission. Panics if the sizes do not match,
    /// if there are more handles than there is room for, or if one has a repulsion although there is no room for it.
    pub fn set_cloths(&self, model: &Model) {
        assert_eq!((model.grid, model.batch()), (self.grid, self.batch()));
        assert!(model.handles() <= self.targets.shape()[0], "room for {} handles", self.targets.shape()[0]);
        assert!(self.has_room_for_repulsion() || !model.repels(), "there is no room for a repulsion");
        self.cloths.write(&self.context, &ClothParams::all(model));
        self.iterate.slots.write(&self.context, &model.handle_slots());
    }

    /// Returns the grid.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the number of cloths.
    pub fn batch(&self) -> usize {
        self.x.shape()[0]
    }

    /// Returns the constants of the cloths ([`ClothParams`]), shape [B, 16].
    pub fn cloths(&self) -> &Tensor {
        &self.cloths
    }

    /// Returns the state of the cloths and the targets of their handles.
    pub fn state(&self) -> StateTensors<'_> {
        StateTensors { x: &self.x, v: &self.v, targets: &self.targets }
    }

    /// Returns the cloths at the current accelerations.
    pub fn trial(&self) -> Trial<'_> {
        Trial { grid: self.grid, cloths: &self.cloths, x: &self.x, iterate: &self.iterate }
    }

    /// Whether cloths may have a repulsion.
    pub fn has_room_for_repulsion(&self) -> bool {
        self.repulsion.is_some()
    }

    /// Returns the parts of the energy in which an evaluation leaves that of the repulsion, if there is one.
    pub fn repulsion_parts(&self) -> Option<&Tensor> {
        self.repulsion.as_ref().map(|_| &self.parts)
    }

    /// Appends the start of a frame: the displacement by the velocities and of the handles to their targets, and the
    /// external accelerations, constant from then on. Two dispatches.
    pub fn begin_frame(&self, schedule: &mut Schedule, begin: Begin) -> Result<()> {
        let predict = match begin {
            Begin::Zero => Predict::new(&self.context)?,
            Begin::Kept => Predict::in_a_frame(&self.context)?,
        };
        predict.push(schedule, self.state(), &self.iterate);
        let Self { cloths, wind, x, v, control_accelerations, iterate, .. } = self;
        let from = ExternalForceTensors { cloths, wind, x, v, control_accelerations };
        self.external_force.push(schedule, self.grid, from, &iterate.external);
        Ok(())
    }

    /// Appends the gradient at `iterate.a`, with partial sums of its squares and of those of the last step
    /// ([`Gradient::push`]). One dispatch, and six more with a repulsion.
    pub fn evaluate(&self, schedule: &mut Schedule, sums: &Tensor) {
        self.repel(schedule);
        self.gradient.push(schedule, self.trial(), sums);
    }

    /// Appends the quadratic model of the energy along `directions` at `iterate.a`, where it was evaluated, in parts
    /// [B, parts, 24] ([`Curvature::push`]). The energy of the repulsion is in [`Objective::repulsion_parts`]. One
    /// dispatch, and another with a repulsion.
    pub fn local_model(&self, schedule: &mut Schedule, directions: &Tensor, parts: &Tensor) {
        self.curvature.push(schedule, self.trial(), [directions, parts]);
        if let Some((repulsion, curvature)) = &self.repulsion {
            curvature.push(schedule, self.trial(), repulsion.cells(), [directions, parts]);
        }
    }

    /// Appends the energy alone at `iterate.a`, in parts as those of [`Objective::local_model`], without an evaluation
    /// before.
    pub fn model_energy(&self, schedule: &mut Schedule, directions: &Tensor, parts: &Tensor) {
        self.repel(schedule);
        self.curvature.push_energy(schedule, self.trial(), [directions, parts]);
    }

    /// Appends the energy terms at `iterate.a`, in [`Objective::terms`].
    pub fn energy(&self, schedule: &mut Schedule) {
        self.energy.push(schedule, self.trial(), &self.parts);
        self.repel(schedule);
        self.energy_sum.push(schedule, &self.parts, &self.terms);
    }

    /// Appends the end of a frame: the state moves to where the accelerations lead. One dispatch.
    pub fn end_frame(&self, schedule: &mut Schedule) {
        self.integrate.push(schedule, self.state(), &self.iterate);
    }

    fn repel(&self, schedule: &mut Schedule) {
        if let Some((repulsion, _)) = &self.repulsion {
            repulsion.push(schedule, self.trial(), &self.parts);
        }
    }
}
