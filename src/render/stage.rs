//! A trajectory set up for drawing: the camera, the lights and everything else that its frames share.

use super::{
    Image, View,
    camera::{Camera, Unit, is_whole, place, range, usable},
    look::Look,
    shade::{self, Lights},
    shadow::{self, Shadow},
    surface::{DepthBuffer, NOTHING},
};
use crate::{
    cloth::Grid,
    io::{Trajectory, vertex_normals},
};
use glam::{Vec3, vec3};

/// Radius of a handle's marker, as a fraction of the picture's height.
const MARKER: f32 = 0.0135;
/// Distance of the floor below the trajectory, as a fraction of the trajectory's height.
const FLOOR: f32 = 0.10;
/// Least distance of the floor \[sizes of the cloth\], for a sheet that lies flat.
const ABOVE_FLOOR: f32 = 0.08;
/// Darkness of the shadow on the floor.
const SHADOW: f32 = 0.34;

/// Number of vertices, over all frames, that suffices to place the camera.
const ENOUGH: usize = 100_000;

/// Everything that the frames of a picture share.
#[derive(Clone)]
pub(super) struct Stage {
    pub size: [usize; 2],
    samples: usize,
    pub grid: Grid,
    pub faces: Vec<[u32; 3]>,
    pub handles: Vec<usize>,
    pub camera: Camera,
    pub lights: Lights,
    /// The unit of all that is drawn.
    unit: Unit,
    up: Vec3,
    /// Height of the floor.
    floor: f32,
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

impl Stage {
    /// Prepares pictures with `samples * samples` samples per pixel. Panics if a handle is not a particle of
    /// the grid.
    pub fn new(trajectory: &Trajectory, handles: &[usize], view: &View, size: Size, samples: usize) -> Self {
        Self::with(trajectory, &[], handles, view, (size, samples))
    }

    /// As [`Stage::new`], with room for the frames of others.
    pub fn with(
        trajectory: &Trajectory,
        others: &[&Trajectory],
        handles: &[usize],
        view: &View,
        (size, samples): (Size, usize),
    ) -> Self {
        let grid = trajectory.grid();
        assert!(handles.iter().all(|&h| h < grid.particles()), "handles are particles of the grid");
        let faces = grid.faces();
        let up = view.up();
        let first: &[[f32; 3]] = if trajectory.frames() > 0 { trajectory.frame(0) } else { &[] };
        let unit = Unit::new(first);
        let every = std::iter::once(trajectory).chain(others.iter().copied());
        let frames = every.flat_map(|of| (0..of.frames()).map(move |f| unit.of(of.frame(f))));
        let all = frames.filter(|frame| is_whole(frame)).flatten().filter(usable);
        let (low, high) = range(all.clone().map(|p| up.dot(Vec3::from(p))));
        let floor = low - (FLOOR * (high - low)).max(ABOVE_FLOOR);
        let on_floor = |p: Vec3| p + up * (floor - up.dot(p));
        // A part of a long or fine trajectory suffices: the points left out lie within the margin around the
        // others. A stride that shares no factor with the number of particles takes different ones in each
        // frame.
        let mut stride = (trajectory.frames() * grid.particles() / ENOUGH) | 1;
        while common_factor(stride, grid.particles()) > 1 {
            stride += 2;
        }
        let points: Vec<Vec3> = all.step_by(stride).map(Vec3::from).flat_map(|p| [p, on_floor(p)]).collect();

        let normals = if first.is_empty() { Vec::new() } else { vertex_normals(&unit.of(first), &faces) };
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
        let facing: Vec3 = normals.iter().map(|&n| Vec3::from(n)).sum();
        let lights = Lights::new(rotation * up, rotation * facing);
        Self { size, samples, grid, faces, handles: handles.to_vec(), camera, lights, unit, up, floor }
    }

    /// Returns the same stage for a cloth on another grid, without markers.
    pub fn on(&self, grid: Grid) -> Self {
        Self { grid, faces: grid.faces(), handles: Vec::new(), ..self.clone() }
    }

    /// Draws the stage without a cloth.
    pub fn draw_empty(&self) -> Image {
        self.draw(&vec![[f32::NAN; 3]; self.grid.particles()])
    }

    /// Whether the cloth is in one piece in a frame.
    pub fn is_whole(&self, positions: &[[f32; 3]]) -> bool {
        let positions = self.unit.of(positions);
        positions.iter().all(usable) && is_whole(&positions)
    }

    /// Draws the positions of a frame \[m\], shape [V, 3].
    pub fn draw(&self, positions: &[[f32; 3]]) -> Image {
        self.draw_heat(positions, &[])
    }

    /// Draws a frame coloured by a number from 0 to 1 at each vertex, or in the cloth's colours if `heat` is
    /// empty.
    pub fn draw_heat(&self, positions: &[[f32; 3]], heat: &[f32]) -> Image {
        let [width, height] = self.size;
        let n = self.samples;
        let positions = &self.unit.of(positions)[..];
        let projected: Vec<Vec3> = positions.iter().map(|p| self.camera.project(place(p))).collect();
        let mut buffer = DepthBuffer::new(width * n, height * n);
        for (k, face) in self.faces.iter().enumerate() {
            buffer.triangle(k as u32, face.map(|v| projected[v as usize]));
        }
        let radius = MARKER * buffer.height as f32;
        for (k, &handle) in self.handles.iter().enumerate() {
            // A marker is a sphere around its vertex, so its front is nearer than the cloth around it.
            let centre = projected[handle];
            let front = vec3(centre.x, centre.y, centre.z * (1.0 - 1.5 * radius / self.camera.focal));
            buffer.disc((self.faces.len() + k) as u32, front, radius);
        }

        let shadow = self.shadow(positions);
        let look = Look::new(self, (positions, heat), projected, radius);
        let mut image = Image::new(width, height);
        for (y, row) in image.pixels.chunks_mut(width).enumerate() {
            let wall = shade::background((y as f32 + 0.5) / height as f32);
            for (x, pixel) in row.iter_mut().enumerate() {
                let (mut sum, mut bare) = (Vec3::ZERO, 0);
                for sy in y * n..(y + 1) * n {
                    for sx in x * n..(x + 1) * n {
                        match buffer.seen[sy * buffer.width + sx] {
                            NOTHING => bare += 1,
                            seen => sum += look.at(seen, sx, sy),
                        }
                    }
                }
                if bare > 0 {
                    sum += wall * (bare as f32 * (1.0 - SHADOW * shadow.at(x, y)));
                }
                *pixel = shade::to_srgb(sum / (n * n) as f32);
            }
        }
        image
    }

    /// Computes the soft shadow of a frame on the floor, lit from straight above.
    fn shadow(&self, positions: &[[f32; 3]]) -> Shadow {
        let scale = 1.0 / (self.samples * shadow::PIXELS) as f32;
        let project = |p: &[f32; 3]| {
            let p = place(p);
            let q = self.camera.project(p + self.up * (self.floor - self.up.dot(p)));
            vec3(q.x * scale, q.y * scale, q.z)
        };
        let corners: Vec<Vec3> = positions.iter().map(project).collect();
        let triangles = self.faces.iter().map(|face| face.map(|v| corners[v as usize]));
        Shadow::new(self.size, triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a sheet of 1 m by 1 m that faces the positive x axis, with y up.
    fn sheet(grid: Grid) -> Vec<[f32; 3]> {
        let at = |k: usize, n: usize| k as f32 / (n - 1) as f32 - 0.5;
        (0..grid.particles()).map(|p| [0.0, at(p / grid.w, grid.h), at(p % grid.w, grid.w)]).collect()
    }

    fn stage(positions: &[[f32; 3]], grid: Grid, azimuth: f32) -> Stage {
        let mut trajectory = Trajectory::new(grid, 60.0);
        trajectory.push(positions, positions);
        let view = View { azimuth: Some(azimuth), elevation: Some(0.0), ..View::default() };
        Stage::new(&trajectory, &[0, 5], &view, Size::Fixed(200, 160), 2)
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
        let stage = Stage::new(&trajectory, &[], &view, Size::Fixed(200, 160), 1);
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
        let image = stage(&positions, grid, 30.0).draw(&positions);
        for (scale, shift) in [(1.0 / 1024.0, 0.5), (16.0, 65536.0), (65536.0, 0.0)] {
            let moved: Vec<_> = positions.iter().map(|p| p.map(|x| scale * x + shift)).collect();
            let other = stage(&moved, grid, 30.0).draw(&moved);
            assert!(other.pixels == image.pixels, "{scale} and {shift}");
        }
    }

    #[test]
    fn a_sheet_that_faces_the_eye_is_a_square_of_the_right_size_with_marked_handles() {
        let grid = Grid { h: 12, w: 9 };
        let positions = sheet(grid);
        for azimuth in [0.0, 180.0] {
            let stage = stage(&positions, grid, azimuth);
            let image = stage.draw(&positions);
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
        let middle = |azimuth: f32| stage(&positions, grid, azimuth).draw(&positions).at(100, 70);
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
        let whole = stage.draw(&positions);
        for (k, bad) in [f32::NAN, f32::INFINITY, 1e38, -1e38].into_iter().enumerate() {
            positions[20 * k + 2][k % 3] = bad;
        }
        assert_ne!(stage.draw(&positions), whole);
        positions.fill([f32::NAN; 3]);
        let empty = stage.draw(&positions);
        assert!(empty.pixels.chunks(200).all(|row| row.iter().all(|p| p == &row[0])));
    }
}
