//! The objective of a frame on a device.

use super::{
    BodyParams, ClothParams, Contacts, Couples, Curvature, Energy, EnergySum, ExternalForce,
    ExternalForceTensors, Gradient, Integrate, Layers, Predict, Repulsion, RepulsionCurvature, StateTensors,
    TERMS, Trial, energy,
};
use crate::Result;
use crate::cloth::{Control, Grid, Mark, Model};
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
    /// Constants of the cloths, shape [B, 24].
    cloths: Tensor,
    /// Parts of the energy, shape [B, parts, 8].
    parts: Tensor,
    external_force: ExternalForce,
    repulsion: Option<(Repulsion, RepulsionCurvature)>,
    contacts: Option<Contacts>,
    layers: Option<Layers>,
    couples: Option<Couples>,
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
    /// Whether cloths may touch themselves, which costs a search for near parts in every frame.
    pub self_contact: bool,
    /// Number of bodies that each cloth may meet, which cost a few dispatches in every evaluation.
    pub bodies: usize,
    /// Number of 32-bit values of the distances of bodies that are meshes ([`Fields`](super::Fields)).
    pub fields: usize,
    /// Whether cloths may have angles at rest, which cost two dispatches in every iteration.
    pub rest_angles: bool,
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
        let free = vec![Mark::default(); batch * grid.particles()];
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
            iterate: match room.repulsion || room.self_contact || room.bodies > 0 || room.rest_angles {
                true => iterate.with_total(context)?,
                false => iterate,
            },
            terms: zeros("energy terms", &[batch, TERMS])?,
            cloths: zeros("cloths", &[batch, ClothParams::LEN])?,
            parts: zeros("energy parts", &energy::parts_shape(batch, grid))?,
            external_force: ExternalForce::new(context)?,
            repulsion: room.repulsion.then(repulsion).transpose()?,
            contacts: (room.bodies > 0)
                .then(|| Contacts::new(context, batch, grid.particles(), [room.bodies, room.fields]))
                .transpose()?,
            layers: room.self_contact.then(|| Layers::new(context, batch, grid)).transpose()?,
            couples: room.rest_angles.then(|| Couples::new(context, batch, grid)).transpose()?,
            gradient: Gradient::new(context)?,
            curvature: Curvature::new(context)?,
            energy: Energy::new(context)?,
            energy_sum: EnergySum::new(context)?,
            integrate: Integrate::new(context)?,
        })
    }

    /// Sets the constants, handles and bodies of the cloths, ahead of the next submission; the bodies stay where the model
    /// has them. Panics if the sizes do not match, or if there are more handles or bodies than there is room for, or a
    /// repulsion, self-contact or rest angles although there is no room for it.
    pub fn set_cloths(&self, model: &Model) {
        assert_eq!((model.grid, model.batch()), (self.grid, self.batch()));
        assert!(model.handles() <= self.targets.shape()[0], "room for {} handles", self.targets.shape()[0]);
        assert!(self.has_room_for_repulsion() || !model.repels(), "there is no room for a repulsion");
        let touches = model.touches_itself();
        assert!(self.has_room_for_self_contact() || !touches, "there is no room for self-contact");
        assert!(
            self.has_room_for_rest_angles() || !model.has_rest_angles(),
            "there is no room for rest angles"
        );
        self.cloths.write(&self.context, &ClothParams::all(model));
        if let Some(couples) = &self.couples {
            couples.set(&self.context, model);
        }
        self.iterate.marks.write(&self.context, &model.marks());
        if let Some((bodies, params)) = self.bodies(model, &Control::<f32>::default()) {
            bodies.write(&self.context, &params);
        }
        if let Some(contacts) = &self.contacts {
            contacts.set_fields(&self.context, model);
        }
    }

    /// Returns the tensor of the bodies and its contents in the frame that `control` drives; `None` without room for
    /// bodies. Panics if there are more than there is room for.
    pub fn bodies<T>(&self, model: &Model, control: &Control<T>) -> Option<(&Tensor, Vec<BodyParams>)> {
        let most = model.cloths.iter().map(|cloth| cloth.bodies.len()).max().unwrap_or(0);
        assert!(most <= self.room_for_bodies(), "room for {} bodies", self.room_for_bodies());
        let contacts = self.contacts.as_ref()?;
        Some((&contacts.bodies, BodyParams::all(model, control, contacts.count())))
    }

    /// Returns the number of bodies that each cloth has room for.
    pub fn room_for_bodies(&self) -> usize {
        self.contacts.as_ref().map_or(0, Contacts::count)
    }

    /// Returns the number of values that there is room for of the distances of meshes.
    pub fn room_for_fields(&self) -> usize {
        self.contacts.as_ref().map_or(0, Contacts::room_for_fields)
    }

    /// Returns what each body did in the last frame, shape [B, count, 8]
    /// ([`ClothContacts`](super::ClothContacts)); `None` without room for bodies.
    pub fn contact_report(&self) -> Option<&Tensor> {
        self.contacts.as_ref().map(|contacts| &contacts.report)
    }

    /// Returns what the layers of the cloths did in the last frame, shape [B, 8] ([`ClothLayers`](super::ClothLayers));
    /// `None` without room for self-contact.
    pub fn layer_report(&self) -> Option<&Tensor> {
        self.layers.as_ref().map(|layers| &layers.report)
    }

    /// Returns what computes the contacts of the cloths with themselves; `None` without room for them.
    pub fn layers(&self) -> Option<&Layers> {
        self.layers.as_ref()
    }

    /// Returns the grid.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the number of cloths.
    pub fn batch(&self) -> usize {
        self.x.shape()[0]
    }

    /// Returns the constants of the cloths ([`ClothParams`]), shape [B, 24].
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

    /// Whether cloths may have angles at rest.
    pub fn has_room_for_rest_angles(&self) -> bool {
        self.couples.is_some()
    }

    /// Whether cloths may touch themselves.
    pub fn has_room_for_self_contact(&self) -> bool {
        self.layers.is_some()
    }

    /// Returns the parts of the energy in which an evaluation leaves that of repulsion, contacts and couples, if there are any.
    pub fn position_parts(&self) -> Option<&Tensor> {
        // Where they act, the gradient sees a total of accelerations.
        self.iterate.total.as_ref().map(|_| &self.parts)
    }

    /// Appends the start of a frame: the displacement by the velocities and of the handles to their targets, and the
    /// external accelerations, constant from then on, and with bodies or self-contact the contacts. Two dispatches,
    /// another with bodies and eleven with self-contact.
    pub fn begin_frame(&self, schedule: &mut Schedule, begin: Begin) -> Result<()> {
        let predict = match begin {
            Begin::Zero => Predict::new(&self.context)?,
            Begin::Kept => Predict::in_a_frame(&self.context)?,
        };
        predict.push(schedule, self.state(), &self.iterate);
        let Self { cloths, wind, x, v, control_accelerations, iterate, .. } = self;
        let from = ExternalForceTensors { cloths, marks: &iterate.marks, wind, x, v, control_accelerations };
        self.external_force.push(schedule, self.grid, from, &iterate.external);
        if let Some(contacts) = &self.contacts {
            contacts.find(schedule, self.trial());
        }
        if let Some(layers) = &self.layers {
            layers.find(schedule, self.trial());
        }
        Ok(())
    }

    /// Appends what keeps particles out of the bodies, where there are any: changes `iterate.a`, and with `directions` also
    /// the last step among them and in the hidden state, if there is one.
    pub fn confine(&self, schedule: &mut Schedule, directions: Option<&Tensor>) {
        if let Some(contacts) = &self.contacts {
            contacts.confine(schedule, self.trial(), directions);
        }
    }

    /// Appends what shortens `axes` [B, 16, n] where contacts hold the particles at `iterate.a`. One dispatch with bodies, and
    /// one with self-contact.
    pub fn shorten_axes(&self, schedule: &mut Schedule, axes: &Tensor) {
        if let Some(contacts) = &self.contacts {
            contacts.shorten_axes(schedule, self.trial(), axes);
        }
        if let Some(layers) = &self.layers {
            layers.shorten_axes(schedule, self.trial(), axes);
        }
    }

    /// Appends the gradient at `iterate.a`, with partial sums of its squares and of those of the last step
    /// ([`Gradient::push`]). One dispatch, six more with a repulsion, another with bodies, two with self-contact and one with angles at rest.
    pub fn evaluate(&self, schedule: &mut Schedule, sums: &Tensor) {
        self.push_by_positions(schedule);
        self.gradient.push(schedule, self.trial(), sums);
    }

    /// Appends the quadratic model of the energy along `directions` at `iterate.a`, where it was evaluated, in parts
    /// [B, parts, 24] ([`Curvature::push`]). The energy of repulsion, contacts and couples is in [`Objective::position_parts`].
    /// One dispatch, and another each with a repulsion, with bodies, with self-contact and with angles at rest.
    pub fn local_model(&self, schedule: &mut Schedule, directions: &Tensor, parts: &Tensor) {
        self.curvature.push(schedule, self.trial(), [directions, parts]);
        if let Some((repulsion, curvature)) = &self.repulsion {
            curvature.push(schedule, self.trial(), repulsion.cells(), [directions, parts]);
        }
        if let Some(contacts) = &self.contacts {
            contacts.push_curvature(schedule, self.trial(), [directions, parts]);
        }
        if let Some(layers) = &self.layers {
            layers.push_curvature(schedule, self.trial(), [directions, parts]);
        }
        if let Some(couples) = &self.couples {
            couples.push_curvature(schedule, self.trial(), [directions, parts]);
        }
    }

    /// Appends the energy alone at `iterate.a`, in parts as those of [`Objective::local_model`], without an evaluation
    /// before.
    pub fn model_energy(&self, schedule: &mut Schedule, directions: &Tensor, parts: &Tensor) {
        self.push_by_positions(schedule);
        self.curvature.push_energy(schedule, self.trial(), [directions, parts]);
    }

    /// Appends what keeps the layers of cloths that touch themselves apart at the end of a frame: changes `iterate.a`
    /// ([`Layers::part`]).
    pub fn part_layers(&self, schedule: &mut Schedule) {
        if let Some(layers) = &self.layers {
            layers.part(schedule, self.trial());
        }
    }

    /// Appends the energy terms at `iterate.a`, in [`Objective::terms`], what the bodies do, in
    /// [`Objective::contact_report`], and what the layers do, in [`Objective::layer_report`].
    pub fn energy(&self, schedule: &mut Schedule) {
        let rest_angles = self.couples.as_ref().map(|couples| &couples.rest_angles);
        self.energy.push(schedule, self.trial(), rest_angles, &self.parts);
        self.repel(schedule);
        self.energy_sum.push(schedule, &self.parts, &self.terms);
        if let Some(contacts) = &self.contacts {
            contacts.report(schedule, self.trial());
        }
        if let Some(layers) = &self.layers {
            layers.report(schedule, self.trial());
        }
    }

    /// Appends the end of a frame: the state moves to where the accelerations lead. One dispatch, and another with bodies.
    pub fn end_frame(&self, schedule: &mut Schedule) {
        self.integrate.push(schedule, self.state(), &self.iterate);
        if let Some(contacts) = &self.contacts {
            contacts.end_frame(schedule, [&self.x, &self.v]);
        }
    }

    /// Appends the forces that depend on the positions, and their energy.
    fn push_by_positions(&self, schedule: &mut Schedule) {
        self.repel(schedule);
        // The first of them sets the sums to which the others add.
        let mut after_others = self.repulsion.is_some();
        if let Some(contacts) = &self.contacts {
            contacts.push(schedule, self.trial(), after_others, &self.parts);
            after_others = true;
        }
        if let Some(layers) = &self.layers {
            layers.push(schedule, self.trial(), after_others, &self.parts);
            after_others = true;
        }
        if let Some(couples) = &self.couples {
            couples.push(schedule, self.trial(), after_others, &self.parts);
        }
    }

    fn repel(&self, schedule: &mut Schedule) {
        if let Some((repulsion, _)) = &self.repulsion {
            repulsion.push(schedule, self.trial(), &self.parts);
        }
    }
}
