//! The viewer without a window: pictures, the pointer, the panel's actions, and the command.

mod command;
mod pointer;
mod runs;

use fnopt::gpu::{AdapterChoice, Context};
use fnopt::render::Image;
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use fnopt::view::egui::{Event, Modifiers, PointerButton, pos2};
use fnopt::view::{Content, FORMAT, Live, Offscreen, Viewer};
use std::path::Path;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A sheet that hangs from two corners.
const HANGING: &str = r#"{"grid": [16, 16], "motion": "none"}"#;
const SIZE: [u32; 2] = [700, 400];
/// The time of a frame.
const FRAME: Duration = Duration::from_nanos(16_666_667);

/// The device of all tests.
fn context() -> &'static Context {
    static CONTEXT: LazyLock<Context> = LazyLock::new(|| {
        Context::headless(&AdapterChoice::Name("llvmpipe".into()))
            .expect("Mesa's software driver (tests/run.sh installs it)")
    });
    &CONTEXT
}

/// A viewer and the picture that it draws into.
struct Screen {
    viewer: Viewer,
    picture: Offscreen,
    out: tempfile::TempDir,
    /// A software driver uses all cores, so one test at a time does.
    _turn: MutexGuard<'static, ()>,
}

impl Screen {
    fn of(scene: &str) -> Self {
        Self::showing(|context| {
            let setup = Scene::parse(scene, "scene", Path::new("")).unwrap().setup().unwrap();
            Content::Live(Box::new(Live::new(context, setup, Optimizer::spectral(), 10).unwrap()))
        })
    }

    fn showing(content: impl FnOnce(&Context) -> Content) -> Self {
        static TURN: Mutex<()> = Mutex::new(());
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let out = tempfile::tempdir().unwrap();
        let mut viewer = Viewer::new(context(), content(context()), (FORMAT, SIZE), out.path()).unwrap();
        let mut picture = Offscreen::new(context(), SIZE).unwrap();
        picture.frame(&mut viewer, Vec::new(), Duration::ZERO).unwrap();
        Self { viewer, picture, out, _turn: turn }
    }

    fn events(&mut self, events: Vec<Event>, elapsed: Duration) {
        self.picture.frame(&mut self.viewer, events, elapsed).unwrap();
    }

    /// Lets so many frames pass, one in each picture.
    fn pass(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.events(Vec::new(), FRAME));
        self.viewer.settle().unwrap();
    }

    fn image(&mut self) -> Image {
        self.events(Vec::new(), Duration::ZERO);
        self.picture.image().unwrap()
    }

    fn live(&self) -> &Live {
        self.viewer.live().unwrap()
    }

    /// Where a particle is in the picture.
    fn place(&self, particle: usize) -> [f32; 2] {
        self.viewer.place_of(self.live().positions()[particle]).unwrap()
    }

    fn button(&mut self, button: PointerButton, [x, y]: [f32; 2], pressed: bool) {
        let (pos, modifiers) = (pos2(x, y), Modifiers::default());
        let button = Event::PointerButton { pos, button, pressed, modifiers };
        self.events(vec![Event::PointerMoved(pos), button], Duration::ZERO);
    }

    fn move_to(&mut self, [x, y]: [f32; 2]) {
        self.events(vec![Event::PointerMoved(pos2(x, y))], FRAME);
    }
}

fn apart(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// How many pixels of the part that shows the cloth are not background, which is the same along each row.
fn covered(screen: &Screen, image: &Image) -> usize {
    let [width, height] = screen.viewer.area().size.map(|side| side as usize);
    let differs = |x: usize, y: usize| {
        let (pixel, wall) = (image.at(x, y), image.at(0, y));
        (0..3).any(|c| pixel[c].abs_diff(wall[c]) > 12)
    };
    (0..height).map(|y| (0..width).filter(|&x| differs(x, y)).count()).sum()
}

/// The share of pixels in which two pictures differ, beside the panel.
fn changed(screen: &Screen, a: &Image, b: &Image) -> f64 {
    let [width, height] = screen.viewer.area().size.map(|side| side as usize);
    let differs = |x: usize, y: usize| (0..3).any(|c| a.at(x, y)[c].abs_diff(b.at(x, y)[c]) > 8);
    let count: usize = (0..height).map(|y| (0..width).filter(|&x| differs(x, y)).count()).sum();
    count as f64 / (width * height) as f64
}
