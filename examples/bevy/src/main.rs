//! A cloth in Bevy: it falls on a ball while a hand leads one of its corners.
//!
//!     cargo run --ignore-rust-version                                       # arrow keys, Page Up and Page Down move the hand
//!     cargo run --ignore-rust-version -- --screenshot cloth.png --frames 90 # without a window
//!
//! `--solver NAME` takes another solver, such as fnopt.

mod cloth;
mod gpu;

use bevy::app::ScheduleRunnerPlugin;
use bevy::camera::RenderTarget;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::CascadeShadowConfigBuilder;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::render::view::NoIndirectDrawing;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured, save_to_disk};
use bevy::time::TimeUpdateStrategy;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use cloth::{Cloth, ClothPlugin, Handles};
use fnopt::network::Weights;
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use std::error::Error;
use std::path::PathBuf;
use std::time::Duration;

/// The cloth lies over a ball, held at one corner, which is at [0, 0, 0.5] m.
const SCENE: &str = r#"{
    "grid": [64, 64], "start": "flat", "handles": [[0, 0]], "motion": "none", "material": "denim",
    "bodies": [{"shape": "sphere", "radius_m": 0.25, "position_m": [0.5, -0.3, 0]}]
}"#;
const BALL: (f32, Vec3) = (0.25, Vec3::new(0.5, -0.3, 0.0));
const FLOOR: f32 = -0.9;
/// Speed of the hand under the keys [m/s].
const SPEED: f32 = 0.8;

/// What the command line asks for.
#[derive(Resource, Clone)]
struct Options {
    screenshot: Option<PathBuf>,
    frames: u32,
    optimizer: Optimizer,
}

fn options() -> Result<Options, Box<dyn Error>> {
    let mut options = Options { screenshot: None, frames: 90, optimizer: Optimizer::spectral() };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word}: expected a value after it"))?;
        match word.as_str() {
            "--screenshot" => options.screenshot = Some(value.into()),
            "--frames" => {
                options.frames =
                    value.parse().map_err(|_| format!("--frames: expected a number, found {value}"))?
            }
            "--solver" => {
                options.optimizer = Optimizer::named(&value, "--solver", || Ok(Weights::shipped()))?
            }
            _ => {
                return Err(
                    format!("expected --screenshot FILE, --frames N or --solver NAME, found {word}").into()
                );
            }
        }
    }
    if !options.optimizer.runs_on_gpu() {
        return Err(
            format!("--solver: expected one that runs on a GPU, found {}", options.optimizer.name()).into()
        );
    }
    Ok(options)
}

fn main() {
    let options = options().unwrap_or_else(|problem| {
        eprintln!("error: {problem}");
        std::process::exit(2)
    });
    let mut app = App::new();
    match options.screenshot {
        None => app.add_plugins(DefaultPlugins),
        Some(_) => {
            let window =
                WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
            // So that the first frame has everything.
            let render = RenderPlugin { synchronous_pipeline_compilation: true, ..default() };
            let plugins = DefaultPlugins.set(window).set(render).disable::<WinitPlugin>();
            app.add_plugins((plugins, ScheduleRunnerPlugin::run_loop(Duration::ZERO)));
            // Every update is a frame, however long it takes.
            app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_secs_f64(1.0 / 60.0)))
        }
    };
    app.add_plugins(ClothPlugin)
        .insert_resource(Time::<Fixed>::from_seconds(1.0 / 60.0))
        // On a slow device the cloth gets slower, and not the picture.
        .insert_resource(Time::<Virtual>::from_max_delta(Duration::from_millis(50)))
        .insert_resource(options)
        .add_systems(Startup, set_up)
        .add_systems(FixedUpdate, (move_hand, hold).chain())
        .add_systems(Update, shoot.run_if(|options: Res<Options>| options.screenshot.is_some()));
    if let AppExit::Error(code) = app.run() {
        std::process::exit(code.get().into())
    }
}

/// What leads a handle of a cloth.
#[derive(Component)]
struct Hand {
    cloth: Entity,
    handle: usize,
    /// Where the keys have moved it [m].
    offset: Vec3,
}

/// The picture that a screenshot shows.
#[derive(Resource)]
struct Picture(Handle<Image>);

fn set_up(
    mut commands: Commands,
    options: Res<Options>,
    mut images: ResMut<Assets<Image>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) -> Result {
    let scene = Scene::parse(SCENE, "scene", std::path::Path::new(""))?;
    let fabric = StandardMaterial {
        base_color: Color::srgb(0.16, 0.27, 0.55),
        perceptual_roughness: 0.9,
        double_sided: true,
        cull_mode: None,
        ..default()
    };
    let Options { optimizer, .. } = options.clone();
    let iterations = optimizer.default_iterations();
    let cloth =
        commands.spawn((Cloth { scene, optimizer, iterations }, MeshMaterial3d(materials.add(fabric)))).id();

    let (radius, place) = BALL;
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(radius).mesh().uv(48, 32))),
        MeshMaterial3d(materials.add(Color::srgb(0.8, 0.3, 0.15))),
        Transform::from_translation(place),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(0.025))),
        MeshMaterial3d(materials.add(Color::srgb(0.9, 0.8, 0.3))),
        Hand { cloth, handle: 0, offset: Vec3::ZERO },
        Transform::default(),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(6.0, 6.0))),
        MeshMaterial3d(materials.add(Color::srgb(0.6, 0.6, 0.58))),
        Transform::from_xyz(0.0, FLOOR, 0.0),
    ));
    commands.insert_resource(GlobalAmbientLight { brightness: 500.0, ..default() });
    commands.spawn((
        DirectionalLight { illuminance: 9_000.0, shadow_maps_enabled: true, ..default() },
        CascadeShadowConfigBuilder { num_cascades: 1, maximum_distance: 6.0, ..default() }.build(),
        Transform::from_xyz(2.0, 4.0, 1.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    let mut camera = commands.spawn((
        Camera3d::default(),
        Tonemapping::Reinhard,
        NoIndirectDrawing,
        Transform::from_xyz(1.6, 0.7, 1.9).looking_at(Vec3::new(0.45, -0.25, 0.0), Vec3::Y),
    ));
    if options.screenshot.is_some() {
        let picture = images.add(Image::new_target_texture(640, 480, TextureFormat::Rgba8UnormSrgb, None));
        camera.insert(RenderTarget::from(picture.clone()));
        commands.insert_resource(Picture(picture));
    }
    Ok(())
}

/// Moves the hands: up and to and fro by themselves, and by the keys.
fn move_hand(
    time: Res<Time>,
    keys: Res<ButtonInput<KeyCode>>,
    mut hands: Query<(&mut Hand, &mut Transform)>,
) {
    let key = |plus, minus| f32::from(keys.pressed(plus)) - f32::from(keys.pressed(minus));
    let step = SPEED * time.delta_secs();
    for (mut hand, mut transform) in &mut hands {
        hand.offset += step
            * Vec3::new(
                key(KeyCode::ArrowRight, KeyCode::ArrowLeft),
                key(KeyCode::PageUp, KeyCode::PageDown),
                key(KeyCode::ArrowDown, KeyCode::ArrowUp),
            );
        let phase = time.elapsed_secs();
        let swing = Vec3::new(0.15 * (1.3 * phase).sin(), 0.2 * (1.0 - (0.9 * phase).cos()), 0.0);
        transform.translation = Vec3::new(0.0, 0.0, 0.5) + swing + hand.offset;
    }
}

/// Lets the handles follow the hands.
fn hold(hands: Query<(&Hand, &Transform)>, mut cloths: Query<(&mut Handles, &GlobalTransform)>) {
    for (hand, place) in &hands {
        let Ok((mut handles, cloth)) = cloths.get_mut(hand.cloth) else { continue };
        if let Some(handle) = handles.get_mut(hand.handle) {
            *handle = cloth.affine().inverse().transform_point3(place.translation);
        }
    }
}

/// Takes a picture in the last frame, and ends.
fn shoot(mut commands: Commands, options: Res<Options>, picture: Res<Picture>, mut frame: Local<u32>) {
    *frame += 1;
    let (Some(path), true) = (options.screenshot.clone(), *frame == options.frames.max(1)) else { return };
    commands.spawn(Screenshot::image(picture.0.clone())).observe(save_to_disk(path)).observe(
        |_: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
            exit.write(AppExit::Success);
        },
    );
}
