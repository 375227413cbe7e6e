//! A trajectory set up for drawing: the camera, the lights and everything else that its frames share.

use super::{
    Bodies, Film, Image, Marks, View,
    body::{Room, Solid},
    camera::{Camera, Unit, is_whole, place, range, usable},
    look::Look,
    shade::{self, Lights},
    shadow::{self, Shadow},
    surface::{DepthBuffer, NOTHING},
};
use crate::{cloth::Grid, io::vertex_normals};
use glam::{Vec2, Vec3, vec2, vec3};

/// Radius of a handle's marker, as a fraction of the picture's height.
pub(crate) const MARKER: f32 = 0.0135;
/// Distance of the floor below the trajectory, as a fraction of the trajectory's height.
const FLOOR: f32 = 0.10;
/// Least distance of the floor \[sizes of the cloth\], for a sheet that lies flat.
const ABOVE_FLOOR: f32 = 0.08;
/// Darkness of the shadow on the floor.
const SHADOW: f32 = 0.34;

/// Number of vertices, over all frames, that suffices to place the camera; and likewise of points of bodies.
const ENOUGH: usize = 100_000;

/// Everything that the frames of a picture share.
#[derive(Clone)]
pub(super) struct Stage<'a> {
    pub size: [usize; 2],
    samples: usize,
    pub grid: Grid,
    pub faces: Vec<[u32; 3]>,
    /// Vertices to mark, which may change from frame to frame.
    pub handles: Marks,
    bodies: &'a Bodies,
    pub camera: Camera,
    pub lights: Lights,
    /// The unit of all that is drawn.
    unit: Unit,
    up: Vec3,
    /// Height of the floor, where no body is one.
    floor: f32,
    room: Room,
}

/// What the shadow lies on: all points p with `slope . p = height`, where the upward component of the slope is 1.
#[derive(Clone, Copy)]
struct Floor {
    slope: Vec3,
    height: f32,
}

/// Size of a picture \[px\].
pub(super) enum Size {
    /// Width and height.
    Fixed(usize, usize),
    /// Height; the width follows from the shape of the trajectory.
    Height(usize),
}

/// Returns the greatest common divisor of two numbers.
fn common_factor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { common_factor(b, a % b) }
}

impl<'a> Stage<'a> {
    /// Prepares pictures with `samples * samples` samples per pixel, which show the handles and the bodies in
    /// `marked`. Panics if a handle is not a particle of the grid.
    pub fn new<'f>(
        film: impl Into<Film<'f>>,
        marked: (Marks, &'a Bodies),
        view: &View,
        size: Size,
        samples: usize,
    ) -> Self {
        Self::with(film.into(), &[], marked, view, (size, samples))
    }

    /// As [`Stage::new`], with room for the frames of others.
    pub fn with(
        film: Film<'_>,
        others: &[Film<'_>],
        (handles, bodies): (Marks, &'a Bodies),
        view: &View,
        (size, samples): (Size, usize),
    ) -> Self {
        let grid = film.grid;
        assert!(handles.all().all(|h| h < grid.particles()), "handles are particles of the grid");
        let faces: Vec<[u32; 3]> = film.frames.topology().triangles().collect();
        let up = view.up();
        let first = if film.frames() > 0 { film.frame(0) } else { Vec::new().into() };
        let unit = Unit::new(&first);
        let every = std::iter::once(film).chain(others.iter().copied());
        let frames = every.flat_map(|of| (0..of.frames()).map(move |f| unit.of(&of.frame(f))));
        let all = frames.filter(|frame| is_whole(frame)).flatten().filter(usable);
        // Only bodies need the room.
        let needed = if bodies.is_empty() { 0 } else { usize::MAX };
        let room = Room::around(all.clone().map(Vec3::from).take(needed));
        let outlines =
            bodies.outlines(film.number(film.frames().saturating_sub(1)) + 1, &unit, &room, ENOUGH);
        let heights = all.clone().map(Vec3::from).chain(outlines.iter().copied()).map(|p| up.dot(p));
        let (low, high) = range(heights);
        let floor = low - (FLOOR * (high - low)).max(ABOVE_FLOOR);
        let on_floor = |p: Vec3| p + up * (floor - up.dot(p));
        // A part of a long or fine trajectory suffices: the points left out lie within the margin around the
        // others. A stride that shares no factor with the number of particles takes different ones in each
        // frame.
        let mut stride = (film.frames() * grid.particles() / ENOUGH) | 1;
        while common_factor(stride, grid.particles()) > 1 {
            stride += 2;
        }
        let points = all.step_by(stride).map(Vec3::from).chain(outlines);
        let points: Vec<Vec3> = points.flat_map(|p| [p, on_floor(p)]).collect();

        let mut normals =
            if first.is_empty() { Vec::new() } else { vertex_normals(&unit.of(&first), &faces) };
        let sum = |normals: &[[f32; 3]]| normals.iter().map(|&n| Vec3::from(n)).sum::<Vec3>();
        if bodies.outward(up).is_some_and(|outward| sum(&normals).dot(outward) < 0.0) {
            // A wall would hide a cloth that is seen from its inner side, so the back of the cloth counts as its front.
            normals.iter_mut().for_each(|n| *n = n.map(|c| -c));
        }
        let rotation = view.rotation(&normals, &points);
        let size = match size {
            Size::Fixed(width, height) => [width, height],
            Size::Height(height) => {
                let extent = |axis: usize| {
                    let (low, high) = range(points.iter().map(|&p| rotation.row(axis).dot(p)));
                    (high - low).max(1e-3)
                };
                let shape = if points.is_empty() { 1.0 } else { (extent(0) / extent(1)).clamp(0.55, 1.3) };
                [(height as f32 * shape).round() as usize, height]
            }
        };
        let camera = Camera::fit(rotation, &points, size.map(|n| n * samples));
        let lights = Lights::new(rotation * up, rotation * sum(&normals));
        Self { size, samples, grid, faces, handles, bodies, camera, lights, unit, up, floor, room }
    }

    /// Returns the same stage for a cloth on another grid, without markers.
    pub fn on(&self, grid: Grid) -> Self {
        Self { grid, faces: grid.faces(), handles: Marks::default(), ..self.clone() }
    }

    /// Draws the stage without a cloth.
    pub fn draw_empty(&self) -> Image {
        self.draw(0, &vec![[f32::NAN; 3]; self.grid.particles()])
    }

    /// Whether the cloth is in one piece in a frame.
    pub fn is_whole(&self, positions: &[[f32; 3]]) -> bool {
        let positions = self.unit.of(positions);
        positions.iter().all(usable) && is_whole(&positions)
    }

    /// Draws the positions of a frame \[m\], shape [V, 3], and the bodies where they are in it.
    pub fn draw(&self, frame: usize, positions: &[[f32; 3]]) -> Image {
        self.draw_heat(frame, positions, &[])
    }

    /// Draws a frame coloured by a number from 0 to 1 at each vertex, or in the cloth's colours if `heat` is
    /// empty.
    pub fn draw_heat(&self, frame: usize, positions: &[[f32; 3]], heat: &[f32]) -> Image {
        let [width, height] = self.size;
        let n = self.samples;
        let positions = &self.unit.of(positions)[..];
        let projected: Vec<Vec3> = positions.iter().map(|p| self.camera.project(place(p))).collect();
        let mut buffer = DepthBuffer::new(width * n, height * n);
        let solids = self.bodies.seen(frame, &self.unit, &self.camera, &self.room);
        let handles = self.handles.at(frame);
        let first_solid = (self.faces.len() + handles.len()) as u32;
        for (solid, object) in solids.iter().zip(first_solid..) {
            buffer.solid(object, solid.bounds(&self.camera), |place| solid.distance(self.camera.ray(place)));
        }
        for (k, face) in self.faces.iter().enumerate() {
            buffer.triangle(k as u32, face.map(|v| projected[v as usize]));
        }
        let radius = MARKER * buffer.height as f32;
        for (k, &handle) in handles.iter().enumerate() {
            // A marker is a sphere around its vertex, so its front is nearer than the cloth around it.
            let centre = projected[handle];
            let front = vec3(centre.x, centre.y, centre.z * (1.0 - 1.5 * radius / self.camera.focal));
            buffer.disc((self.faces.len() + k) as u32, front, radius);
        }

        let shadow = self.shadow(positions, &solids);
        let look = Look::new(self, (positions, heat), handles, projected, radius);
        let mut image = Image::new(width, height);
        for (y, row) in image.pixels.chunks_mut(width).enumerate() {
            let wall = shade::background((y as f32 + 0.5) / height as f32);
            for (x, pixel) in row.iter_mut().enumerate() {
                // Of all samples; of planes; and the number of those that show nothing.
                let (mut sum, mut ground, mut bare) = (Vec3::ZERO, Vec3::ZERO, 0);
                for sy in y * n..(y + 1) * n {
                    for sx in x * n..(x + 1) * n {
                        match buffer.seen[sy * buffer.width + sx] {
                            NOTHING => bare += 1,
                            seen if seen < first_solid => sum += look.at(seen, sx, sy),
                            seen => {
                                let ray = self.camera.ray(vec2(sx as f32 + 0.5, sy as f32 + 0.5));
                                let Some(spot) = solids[(seen - first_solid) as usize].spot(ray) else {
                                    continue;
                                };
                                let light = self.lights.body(&spot);
                                let seen = if spot.is_plane { &mut ground } else { &mut sum };
                                *seen += wall.lerp(light, spot.opacity);
                            }
                        }
                    }
                }
                if bare > 0 || ground != Vec3::ZERO {
                    let lit = 1.0 - SHADOW * shadow.at(x, y);
                    sum += wall * (bare as f32 * lit) + ground * lit;
                }
                *pixel = shade::to_srgb(sum / (n * n) as f32);
            }
        }
        image
    }

    /// Computes the soft shadow of a frame on the floor, lit from straight above.
    fn shadow(&self, positions: &[[f32; 3]], solids: &[Solid]) -> Shadow {
        let scale = 1.0 / (self.samples * shadow::PIXELS) as f32;
        let own = solids.iter().find_map(|solid| solid.floor(self.up));
        let floor = own.map_or(Floor { slope: self.up, height: self.floor }, |(normal, height)| {
            let steep = normal.dot(self.up);
            Floor { slope: normal / steep, height: height / steep }
        });
        let project = |p: &[f32; 3]| {
            let p = place(p);
            let q = self.camera.project(p + self.up * (floor.height - floor.slope.dot(p)));
            vec3(q.x * scale, q.y * scale, q.z)
        };
        let (slope, up) = (self.camera.rotation * floor.slope, self.camera.rotation * self.up);
        let height = floor.height - slope.dot(self.camera.eye());
        let is_dark = |at: Vec2| {
            let ray = self.camera.ray(at / scale);
            let times = height / slope.dot(ray);
            times > 0.0 && times.is_finite() && solids.iter().any(|solid| solid.shades(times * ray, up))
        };
        let corners: Vec<Vec3> = positions.iter().map(project).collect();
        let triangles = self.faces.iter().map(|face| face.map(|v| corners[v as usize]));
        Shadow::new(self.size, triangles, is_dark)
    }
}

#[cfg(test)]
mod tests {
    use super::{super::body::NONE, *};
    use crate::cloth::{Body, Pose, Shape, VertexView};
    use crate::io::Trajectory;

    /// Returns a sheet of 1 m by 1 m that faces the positive x axis, with y up.
    fn sheet(grid: Grid) -> Vec<[f32; 3]> {
        let at = |k: usize, n: usize| k as f32 / (n - 1) as f32 - 0.5;
        (0..grid.particles()).map(|p| [0.0, at(p / grid.w, grid.h), at(p % grid.w, grid.w)]).collect()
    }

    fn stage(positions: &[[f32; 3]], grid: Grid, azimuth: f32) -> Stage<'static> {
        let mut trajectory = Trajectory::new(grid, 60.0);
        trajectory.push(positions, positions);
        let view = View { azimuth: Some(azimuth), elevation: Some(0.0), ..View::default() };
        Stage::new(&trajectory, ((&[0, 5]).into(), &NONE), &view, Size::Fixed(200, 160), 2)
    }

    #[test]
    fn no_column_of_a_long_run_is_left_out_of_the_picture() {
        // As many points as would be sampled with a stride of 15, which is a factor of their number.
        let grid = Grid { h: 45, w: 45 };
        let positions = sheet(grid);
        let mut trajectory = Trajectory::new(grid, 60.0);
        while trajectory.frames() * grid.particles() / ENOUGH < 14 {
            trajectory.push(&positions, &positions);
        }
        let view = View { azimuth: Some(0.0), elevation: Some(0.0), ..View::default() };
        let stage = Stage::new(&trajectory, (Marks::default(), &NONE), &view, Size::Fixed(200, 160), 1);
        for &p in &positions {
            let at = stage.camera.project(Vec3::from(p));
            assert!((0.0..200.0).contains(&at.x) && (0.0..160.0).contains(&at.y), "{p:?} is drawn at {at}");
        }
    }

    /// Far from the origin, or a millimetre in size, cloths used to be drawn in part or not at all.
    #[test]
    fn pictures_do_not_depend_on_place_and_size() {
        let grid = Grid { h: 9, w: 9 };
        let positions = sheet(grid);
        let image = stage(&positions, grid, 30.0).draw(0, &positions);
        for (scale, shift) in [(1.0 / 1024.0, 0.5), (16.0, 65536.0), (65536.0, 0.0)] {
            let moved: Vec<_> = positions.iter().map(|p| p.map(|x| scale * x + shift)).collect();
            let other = stage(&moved, grid, 30.0).draw(0, &moved);
            assert!(other.pixels == image.pixels, "{scale} and {shift}");
        }
    }

    #[test]
    fn a_sheet_that_faces_the_eye_is_a_square_of_the_right_size_with_marked_handles() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        for azimuth in [0.0, 180.0] {
            let stage = stage(&positions, grid, azimuth);
            let image = stage.draw(0, &positions);
            let blue = |p: &[u8; 3]| p[2] > p[0].saturating_add(25);
            let sand = |p: &[u8; 3]| p[0] > p[2].saturating_add(25);
            let corner = |k: usize| stage.camera.project(Vec3::from(positions[k])) / stage.samples as f32;
            let (a, b) = (corner(0), corner(grid.particles() - 1));
            let expected = ((a.x - b.x) * (a.y - b.y)).abs();
            let found = image.pixels.iter().filter(|p| blue(p) || sand(p)).count() as f32;
            assert!((found / expected - 1.0).abs() < 0.03, "{found} of {expected}");
            for handle in [0, 5] {
                let at = corner(handle);
                let [r, g, b] = image.at(at.x as usize, at.y as usize);
                assert!(r > 200 && g < 170 && b < 130, "orange, not {:?}", [r, g, b]);
            }
            let background = shade::to_srgb(shade::background(0.5 / 160.0));
            assert_eq!([image.at(0, 0), image.at(199, 0)], [background; 2]);
        }
    }

    #[test]
    fn the_two_sides_differ() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        let middle = |azimuth: f32| stage(&positions, grid, azimuth).draw(0, &positions).at(100, 70);
        let (one, other) = (middle(0.0), middle(180.0));
        assert!((one[2] > one[0]) != (other[2] > other[0]), "{one:?} and {other:?}");
    }

    #[test]
    fn a_cloth_is_whole_if_all_of_it_is_near() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        let stage = stage(&positions, grid, 0.0);
        assert!(stage.is_whole(&positions));
        for far in [4.0, 1e38, f32::NAN] {
            let mut burst = positions.clone();
            burst[20][1] = far;
            assert!(!stage.is_whole(&burst), "{far}");
        }
    }

    /// A sheet that lies flat used to lie on the floor, in its own shadow.
    #[test]
    fn a_flat_sheet_is_above_the_floor() {
        let grid = Grid { h: 12, w: 9 };
        let flat: Vec<[f32; 3]> = sheet(grid).into_iter().map(|[_, y, z]| [y, 0.0, z]).collect();
        assert!((stage(&flat, grid, 0.0).floor + ABOVE_FLOOR).abs() < 1e-6);
    }

    #[test]
    fn a_cloth_that_is_not_finite_leaves_a_hole() {
        let grid = Grid { h: 12, w: 9 };
        let mut positions = sheet(grid);
        let stage = stage(&positions, grid, 0.0);
        let whole = stage.draw(0, &positions);
        for (k, bad) in [f32::NAN, f32::INFINITY, 1e38, -1e38].into_iter().enumerate() {
            positions[20 * k + 2][k % 3] = bad;
        }
        assert_ne!(stage.draw(0, &positions), whole);
        positions.fill([f32::NAN; 3]);
        let empty = stage.draw(0, &positions);
        assert!(empty.pixels.chunks(200).all(|row| row.iter().all(|p| p == &row[0])));
    }

    /// Returns bodies in metres, each with its places in the frames, which are as thin as bodies may be.
    fn bodies(all: &[(Shape, &[Vec3])]) -> Bodies {
        // The body's up axis is the y axis here.
        let transform = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]];
        let view = VertexView { transform, time: 1.0 };
        let body =
            |shape| Body { shape, pose: Pose::default(), thickness: 1e-3, friction: 0.0, present: true };
        let pose =
            |p: &Vec3| Pose { position: vec3(p.x, -p.z, p.y).as_dvec3().to_array(), ..Pose::default() };
        let poses: Vec<Vec<Pose>> = all.iter().map(|(_, path)| path.iter().map(pose).collect()).collect();
        let all: Vec<Body> = all.iter().map(|(shape, _)| body(shape.clone())).collect();
        Bodies::new(&all, &poses, &view)
    }

    fn repeated(positions: &[[f32; 3]], grid: Grid, frames: usize) -> Trajectory {
        let mut trajectory = Trajectory::new(grid, 60.0);
        (0..frames).for_each(|_| trajectory.push(positions, positions));
        trajectory
    }

    fn with_bodies<'a>(positions: &[[f32; 3]], bodies: &'a Bodies, view: View) -> Stage<'a> {
        let trajectory = repeated(positions, Grid { h: 12, w: 9 }, 3);
        Stage::new(&trajectory, (Marks::default(), bodies), &view, Size::Fixed(200, 160), 2)
    }

    /// Whether a pixel shows a body and not the cloth, which is coloured, or the background, which is light.
    fn is_grey(p: &[u8; 3]) -> bool {
        p.iter().all(|&c| c < 185) && p[0].abs_diff(p[2]) < 16
    }

    const BALL: Shape = Shape::Sphere { radius: 0.2 };

    #[test]
    fn a_ball_before_the_cloth_hides_it_and_one_behind_does_not() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        for azimuth in [0.0, 140.0] {
            let view = View { azimuth: Some(azimuth), elevation: Some(0.0), ..View::default() };
            let eye = stage(&positions, grid, azimuth).camera.rotation.row(2);
            let out = Vec3::X * eye.x.signum();
            let draw = |along: f32| {
                let bodies = bodies(&[(BALL, &[along * out])]);
                let stage = with_bodies(&positions, &bodies, view);
                let at = stage.camera.project(Vec3::ZERO) / stage.samples as f32;
                let image = stage.draw(0, &positions);
                // Above the shadow.
                let greys = image.pixels[..200 * 110].iter().filter(|p| is_grey(p)).count();
                (is_grey(&image.at(at.x as usize, at.y as usize)), greys)
            };
            let ((before, before_all), (behind, behind_all), (through, through_all)) =
                (draw(0.3), draw(-0.21), draw(0.05));
            assert!(before && !behind && through, "{before}, {behind}, {through}");
            // Of a ball that reaches through the cloth, only a part is seen.
            let all = [before_all, behind_all, through_all];
            assert!(behind_all < 30 && through_all > 500 && through_all < before_all, "{all:?}");
        }
    }

    #[test]
    fn a_moving_ball_is_where_it_is_in_the_frame() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        let path = [vec3(0.6, 0.3, 0.3), vec3(0.6, 0.3, -0.3), vec3(0.6, -0.3, -0.3)];
        for shape in [BALL, Shape::Capsule { radius: 0.1, half_length: 0.1 }, Shape::Box { half: [0.15; 3] }]
        {
            let bodies = bodies(&[(shape.clone(), &path)]);
            let view = View { azimuth: Some(0.0), elevation: Some(0.0), ..View::default() };
            let stage = with_bodies(&positions, &bodies, view);
            for frame in 0..4 {
                let image = stage.draw(frame, &positions);
                for (k, place) in path.iter().enumerate() {
                    let at = stage.camera.project(*place) / stage.samples as f32;
                    let found = is_grey(&image.at(at.x as usize, at.y as usize));
                    assert_eq!(found, k == frame.min(2), "{shape:?} in frame {frame}: {place}");
                }
            }
        }
    }

    #[test]
    fn the_floor_does_not_change_the_camera_and_a_near_body_is_seen_whole() {
        let grid = Grid { h: 12, w: 9 };
        let flat: Vec<[f32; 3]> = sheet(grid).into_iter().map(|[_, y, z]| [y, 0.0, z]).collect();
        let floor = (Shape::Plane, &[vec3(0.0, -0.6, 0.0)][..]);
        let camera =
            |all: &[(Shape, &[Vec3])]| with_bodies(&flat, &bodies(all), View::default()).camera.clone();
        assert_eq!(camera(&[]), camera(std::slice::from_ref(&floor)));
        // Neither does a body far away, or one as large as a house.
        assert_eq!(camera(&[]), camera(&[(BALL, &[vec3(4.0, 0.0, 0.0)])]));
        assert_eq!(camera(&[]), camera(&[(Shape::Box { half: [9.0; 3] }, &[vec3(0.0, -9.1, 0.0)])]));

        let below = vec3(0.0, -0.3, 0.0);
        let near = camera(&[(BALL, &[below]), floor.clone()]);
        assert_ne!(camera(&[]), near);
        let bodies = bodies(&[(BALL, &[below]), floor]);
        let stage = with_bodies(&flat, &bodies, View::default());
        assert_eq!(stage.camera, near);
        let solids = stage.bodies.seen(0, &stage.unit, &stage.camera, &stage.room);
        let [low, high] = solids[0].bounds(&stage.camera);
        assert!(low.min_element() > 0.0 && high.x < 400.0 && high.y < 320.0, "{low} to {high}");
    }

    #[test]
    fn a_floor_is_drawn_around_the_cloth_with_its_shadow() {
        let grid = Grid { h: 12, w: 9 };
        let flat: Vec<[f32; 3]> = sheet(grid).into_iter().map(|[_, y, z]| [y, 0.0, z]).collect();
        let bodies = bodies(&[(Shape::Plane, &[vec3(0.0, -0.1, 0.0)])]);
        let stage = with_bodies(&flat, &bodies, View::default());
        let with_cloth = stage.draw(0, &flat);
        let [bare, empty] = [stage.draw_empty(), with_bodies(&flat, &NONE, View::default()).draw_empty()];
        assert_ne!(bare, empty);
        // The top of the patch has faded.
        let top = |image: &Image| image.pixels[..200].to_vec();
        let faded = |(a, b): ([u8; 3], [u8; 3])| a[1].abs_diff(b[1]) < 4;
        assert!(top(&bare).into_iter().zip(top(&empty)).all(faded));
        let under = stage.camera.project(vec3(0.0, -0.1, 0.0)) / stage.samples as f32;
        let light = |image: &Image, [x, y]: [f32; 2]| u32::from(image.at(x as usize, y as usize)[1]);
        assert!(light(&bare, [under.x, under.y]) < light(&empty, [under.x, under.y]));
        // At the near corner of the cloth, its shadow is seen below it.
        let corner = stage.camera.project(
            place(
                flat.iter()
                    .max_by(|a, b| {
                        let near = |p: &[f32; 3]| stage.camera.rotation.row(2).dot(Vec3::from(*p));
                        near(a).total_cmp(&near(b))
                    })
                    .unwrap(),
            ) - vec3(0.0, 0.1, 0.0),
        ) / stage.samples as f32;
        assert!(
            light(&with_cloth, [corner.x, corner.y - 2.0]) + 4 < light(&bare, [corner.x, corner.y - 2.0])
        );
    }
}
