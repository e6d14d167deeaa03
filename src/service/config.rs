//! Settings of the service.

use std::path::PathBuf;
use std::time::Duration;

use axum::http::HeaderName;

use super::workcells::ArchiveLimits;
use crate::jobs::{JobsConfig, Retention};
use crate::wire::ReadLimits;

/// Settings of the service.
#[derive(Debug, Clone)]
pub struct ServiceConfig {
    /// Where jobs and workcells are kept; in memory when there is no such folder.
    pub data_dir: Option<PathBuf>,
    /// The pool of planner threads and its queue.
    pub jobs: JobsConfig,
    /// What is remembered of ended jobs.
    pub retention: Retention,
    /// Bounds on problems; its `max_bytes` bounds every body.
    pub read_limits: ReadLimits,
    /// Most bytes of bodies that are being received or worked on.
    pub bodies_bytes: usize,
    /// Largest plan (bytes) that events carry inline.
    pub inline_plan_bytes: usize,
    /// Most problems that are validated at once.
    pub validations: usize,
    /// Most connections that are open at once.
    pub connections: usize,
    /// Most of them from one address; not counted where `client_header` tells clients apart.
    pub client_connections: usize,
    /// Most streams of events that are open at once.
    pub streams: usize,
    /// Most of them for one client.
    pub client_streams: usize,
    /// How often a silent SSE stream shows that it is alive.
    pub keep_alive: Duration,
    /// Most registered workcells.
    pub workcells: usize,
    /// Most bytes of all workcells and their files, those included that jobs still need.
    pub workcells_bytes: u64,
    /// Bounds on what a bundle holds; the packed bundle is bounded as every body is.
    pub archive: ArchiveLimits,
    /// How long the mode graph of a workcell may be worked on.
    pub mode_graph_budget: Duration,
    /// The header by which a trusted proxy tells clients apart; without one they are told apart by
    /// their addresses.
    pub client_header: Option<HeaderName>,
    /// How long a shutdown may take, replies and planner threads included.
    pub drain: Duration,
}

impl Default for ServiceConfig {
    fn default() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let jobs = JobsConfig::default();
        let most_threads = u64::try_from(processors).unwrap_or(1);
        Self {
            data_dir: None,
            jobs: JobsConfig { client_limit: jobs.queue_limit, ..jobs },
            retention: Retention::default(),
            read_limits: ReadLimits { max_threads: most_threads, ..ReadLimits::default() },
            bodies_bytes: 512 << 20,
            inline_plan_bytes: 1 << 20,
            validations: processors,
            connections: 8192,
            client_connections: 4096,
            streams: 2048,
            client_streams: 256,
            keep_alive: Duration::from_secs(15),
            workcells: 100,
            workcells_bytes: 1 << 30,
            archive: ArchiveLimits::default(),
            mode_graph_budget: Duration::from_secs(10),
            client_header: None,
            drain: Duration::from_secs(10),
        }
    }
}
