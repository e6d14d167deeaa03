//! The `quadrille` command.

use std::process::ExitCode;

/// Planning makes and drops many small lists, on several threads.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    quadrille::cli::main()
}
