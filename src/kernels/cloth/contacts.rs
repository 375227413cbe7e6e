//! The contacts of cloths with bodies on a device.

use super::{
    Contact, ContactAxes, ContactConfine, ContactCurvature, ContactEnd, ContactFind, ContactReport, Trial,
    contact_report,
};
use crate::Result;
use crate::cloth::{Body, Control, DistanceField, MAX_CONTACTS, Model, Shape, Sweep};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::size;
use std::sync::Arc;

/// One element of the WGSL's `array<Body>`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub struct BodyParams {
    sizes: [f32; 3],
    /// 0 for no body.
    kind: u32,
    thickness: f32,
    friction: f32,
    /// Where a mesh's distances begin among those of all.
    field: u32,
    padding: u32,
    from_position: [f32; 4],
    from_rotation: [f32; 4],
    to_position: [f32; 4],
    to_rotation: [f32; 4],
}

impl BodyParams {
    /// Number of 32-bit values in an element.
    pub const LEN: usize = size_of::<Self>() / size_of::<f32>();

    /// Returns the bodies of each cloth and how they move in the frame, with room for `count` of each, shape [B, count].
    pub fn all<T>(model: &Model, control: &Control<T>, count: usize) -> Vec<Self> {
        let fields = &Fields::of(model);
        let of_cloth = |b: usize| {
            let bodies = model.cloths[b].bodies.iter().enumerate();
            let own = bodies.map(move |(k, body)| Self::new(body, control.sweep(model, b, k), fields));
            own.chain(std::iter::repeat(Self::default())).take(count)
        };
        (0..model.batch()).flat_map(of_cloth).collect()
    }

    fn new(body: &Body, sweep: Sweep, fields: &Fields<'_>) -> Self {
        let kind = match body.shape {
            _ if !body.present => 0,
            Shape::Plane => 1,
            Shape::Sphere { .. } => 2,
            Shape::Capsule { .. } => 3,
            Shape::Box { .. } => 4,
            Shape::Mesh { .. } => 5,
        };
        let four = |[x, y, z]: [f64; 3]| [x as f32, y as f32, z as f32, 0.0];
        let rotation = |q: [f64; 4]| q.map(|c| c as f32);
        Self {
            sizes: body.shape.sizes().map(|size| size as f32),
            kind,
            thickness: body.thickness as f32,
            friction: body.friction as f32,
            field: fields.place(&body.shape),
            padding: 0,
            from_position: four(sweep.from.position),
            from_rotation: rotation(sweep.from.rotation),
            to_position: four(sweep.to.position),
            to_rotation: rotation(sweep.to.rotation),
        }
    }
}

/// The distance fields of the meshes among the bodies of a model, each once, one after another.
pub struct Fields<'a> {
    all: Vec<&'a Arc<DistanceField>>,
}

impl<'a> Fields<'a> {
    /// Collects them.
    pub fn of(model: &'a Model) -> Self {
        let mut all: Vec<&Arc<DistanceField>> = Vec::new();
        for body in model.cloths.iter().flat_map(|cloth| &cloth.bodies) {
            if let Shape::Mesh { field, .. } = &body.shape
                && !all.iter().any(|known| Arc::ptr_eq(known, field))
            {
                all.push(field);
            }
        }
        Self { all }
    }

    /// Returns the number of 32-bit values of all.
    pub fn words_count(&self) -> usize {
        self.all.iter().map(|field| field.len_in_words()).sum()
    }

    /// Returns the values.
    fn words(&self) -> Vec<f32> {
        self.all.iter().flat_map(|field| field.words()).collect()
    }

    /// Returns where those of a shape begin; 0 if it has none.
    fn place(&self, shape: &Shape) -> u32 {
        let Shape::Mesh { field, .. } = shape else { return 0 };
        let before = self.all.iter().take_while(|known| !Arc::ptr_eq(known, field));
        size(before.map(|field| field.len_in_words()).sum())
    }
}

/// Number of 32-bit values in an element of the WGSL's `array<Contact>`.
pub const CONTACT: usize = 12;

/// The contacts of a batch of cloths, and what computes with them.
#[derive(Clone, Debug)]
pub struct Contacts {
    /// Bodies of each cloth ([`BodyParams`]), shape [B, count, 24].
    pub bodies: Tensor,
    /// The distances of the bodies that are meshes ([`Fields`]).
    fields: Tensor,
    /// What each body did in the last frame, shape [B, count, 8], see [`contact_report`].
    pub report: Tensor,
    /// Shape [B, slots n, 12].
    contacts: Tensor,
    find: ContactFind,
    axes: ContactAxes,
    contact: Contact,
    curvature: ContactCurvature,
    confine: ContactConfine,
    end: ContactEnd,
    report_kernel: ContactReport,
}

impl Contacts {
    /// Builds the kernels and tensors for `batch` cloths of `n` particles with room for `count` bodies each, of which there
    /// are none yet, and for `fields` values of the distances of meshes.
    pub fn new(context: &Context, batch: usize, n: usize, [count, fields]: [usize; 2]) -> Result<Self> {
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let slots = count.min(MAX_CONTACTS);
        Ok(Self {
            bodies: zeros("bodies", &[batch, count, BodyParams::LEN])?,
            fields: zeros("distance fields", &[fields.max(1)])?,
            report: zeros("contact report", &[batch, count, contact_report::VALUES])?,
            contacts: zeros("contacts", &[batch, slots * n, CONTACT])?,
            find: ContactFind::new(context, slots)?,
            axes: ContactAxes::new(context, slots)?,
            contact: Contact::new(context, slots)?,
            curvature: ContactCurvature::new(context, slots)?,
            confine: ContactConfine::new(context, slots)?,
            end: ContactEnd::new(context, slots)?,
            report_kernel: ContactReport::new(context, slots)?,
        })
    }

    /// Returns the number of bodies that each cloth has room for.
    pub fn count(&self) -> usize {
        self.bodies.shape()[1]
    }

    /// Returns the number of values that there is room for of the distances of meshes.
    pub fn room_for_fields(&self) -> usize {
        self.fields.len()
    }

    /// Sets the distances of the meshes among the bodies of a model. Panics if there is no room for them.
    pub fn set_fields(&self, context: &Context, model: &Model) {
        let fields = Fields::of(model);
        assert!(fields.words_count() <= self.room_for_fields(), "room for {} values", self.room_for_fields());
        if fields.words_count() > 0 {
            self.fields.write_at(context, 0, &fields.words());
        }
    }

    /// Appends the search for the contacts of a frame that begins at `trial`. One dispatch.
    pub fn find(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.find.push(schedule, trial, [&self.bodies, &self.fields, &self.contacts]);
    }

    /// Appends what shortens the axes of the sheet where bodies hold it ([`ContactAxes::push`]). One dispatch.
    pub fn shorten_axes(&self, schedule: &mut Schedule, trial: Trial<'_>, axes: &Tensor) {
        self.axes.push(schedule, trial, [&self.contacts, axes]);
    }

    /// Appends the accelerations by contacts and their energy ([`Contact::push`]). One dispatch.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, after_repulsion: bool, parts: &Tensor) {
        self.contact.push(schedule, trial, after_repulsion, [&self.contacts, parts]);
    }

    /// Appends their second derivatives ([`ContactCurvature::push`]). One dispatch.
    pub fn push_curvature(&self, schedule: &mut Schedule, trial: Trial<'_>, tensors: [&Tensor; 2]) {
        self.curvature.push(schedule, trial, &self.contacts, tensors);
    }

    /// Appends what keeps a step out of the bodies ([`ContactConfine::push`]). One dispatch.
    pub fn confine(&self, schedule: &mut Schedule, trial: Trial<'_>, directions: Option<&Tensor>) {
        self.confine.push(schedule, trial, &self.contacts, directions);
    }

    /// Appends the report at the accepted accelerations, before the frame ends. One dispatch.
    pub fn report(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.report_kernel.push(schedule, trial, [&self.contacts, &self.bodies, &self.fields, &self.report]);
    }

    /// Appends the corrections of a frame's end to `x` and `v`. One dispatch.
    pub fn end_frame(&self, schedule: &mut Schedule, [x, v]: [&Tensor; 2]) {
        self.end.push(schedule, [&self.contacts, x, v]);
    }
}
