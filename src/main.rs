//! The `quadrille` command.

use std::process::ExitCode;

/// Planning makes many small allocations, on all threads at once.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    quadrille::cli::main()
}
