//! The `fnopt` command: arguments and loops; everything else is in the library.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    quieten_device_select();
    let cli = cli::Cli::parse();
    match cli::log_to_stderr() {
        Ok(()) => cli::run(cli),
        Err(error) => {
            cli::output::tell!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Mesa's layer that selects a Vulkan device asks the desktop which one it draws with. Without a desktop it only prints lines that
/// begin with "error:", so it is left out there, unless a variable asks something else of it.
#[expect(unsafe_code, reason = "the environment is the layer's only switch")]
fn quieten_device_select() {
    let asked = ["XDG_RUNTIME_DIR", "DISPLAY", "MESA_VK_DEVICE_SELECT", "DRI_PRIME", "NODEVICE_SELECT"];
    if asked.into_iter().all(|name| std::env::var_os(name).is_none()) {
        // SAFETY: the first thing that `main` does; there is no other thread that could read the environment meanwhile.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
