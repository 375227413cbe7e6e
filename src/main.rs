//! The `fnopt` command: arguments and loops. Everything else is in the library.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    quieten_device_select();
    let cli = cli::Cli::from_command_line();
    match cli::log_to_stderr() {
        Ok(()) => cli::run(cli),
        Err(error) => {
            cli::output::status!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Disables Mesa's device-selection layer if there is no desktop. The layer asks the desktop which Vulkan
/// device it draws with, and without one only prints lines that begin with "error:". An environment variable
/// that configures it is respected.
#[expect(unsafe_code, reason = "the environment is the layer's only switch")]
fn quieten_device_select() {
    let asked = ["XDG_RUNTIME_DIR", "DISPLAY", "MESA_VK_DEVICE_SELECT", "DRI_PRIME", "NODEVICE_SELECT"];
    if asked.into_iter().all(|name| std::env::var_os(name).is_none()) {
        // SAFETY: `main` calls this first, so no other thread can read the environment meanwhile.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
