//! Settings of `serve`: from a file, then the environment, then flags; the later wins.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use serde::Deserialize;
use serde::de::{Deserializer, Error as _};

use super::budget;
use crate::planner::PlannerCache;
use crate::service::{ServiceConfig, files_allowed};

/// Open files that are no connections.
const OTHER_FILES: usize = 64;
/// Longest settings file (bytes).
const LARGEST_FILE: usize = 1 << 20;

/// A span of time, such as `10s`, `500ms`, `2m`, `1h` or `7d`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Span(Duration);

impl FromStr for Span {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        for (unit, seconds) in [('h', 3600), ('d', 24 * 3600)] {
            if let Some(number) = text.trim().strip_suffix(unit) {
                let one = budget::parse(number)?;
                return Ok(Self(one.checked_mul(seconds).ok_or("that is too long")?));
            }
        }
        budget::parse(text).map(Self)
    }
}

impl<'de> Deserialize<'de> for Span {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

/// Declares the settings once: as flags, as environment variables, as keys of the file.
macro_rules! settings {
    ($($(#[doc = $doc:literal])+ $name:ident: $kind:ty = $env:literal $(, $extra:meta)?;)+) => {
        /// Settings that someone has given.
        #[derive(Debug, Clone, Default, PartialEq, clap::Args, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub(super) struct Settings {
            $($(#[doc = $doc])+ #[arg(long, env = $env $(, $extra)?)] pub $name: Option<$kind>,)+
        }

        impl Settings {
            /// These settings, and those of `other` where these say nothing.
            fn or(self, other: Self) -> Self {
                Self { $($name: self.$name.or(other.$name),)+ }
            }
        }
    };
}

settings! {
    /// Address and port for HTTP and gRPC; port 0 takes a free one [default: 127.0.0.1:8080]
    listen: SocketAddr = "QUADRILLE_LISTEN", value_parser = super::socket_address;
    /// Folder in which jobs and workcells are kept [default: none, all is in memory]
    data_dir: PathBuf = "QUADRILLE_DATA_DIR";
    /// Folder in which compiled workcells are kept [default: none, in memory only]
    cache_dir: PathBuf = "QUADRILLE_CACHE_DIR";
    /// Most bytes of that folder [default: 536870912]
    cache_bytes: u64 = "QUADRILLE_CACHE_BYTES";
    /// Planner threads [default: one less than there are processors, at least 1]
    workers: usize = "QUADRILLE_WORKERS";
    /// Most jobs that wait for a planner thread [default: 64]
    queue_limit: usize = "QUADRILLE_QUEUE_LIMIT";
    /// Most jobs of one client that wait or run [default: the queue's limit and the planner threads together]
    client_jobs: usize = "QUADRILLE_CLIENT_JOBS";
    /// How much earlier a job counts as having come, per step of priority [default: 30s]
    priority_aging: Span = "QUADRILLE_PRIORITY_AGING";
    /// Most open connections [default: 8192, or what the system's limit on open files leaves]
    connections: usize = "QUADRILLE_CONNECTIONS";
    /// Most open connections from one address, unless a proxy names the clients [default: half of all]
    client_connections: usize = "QUADRILLE_CLIENT_CONNECTIONS";
    /// Most open streams of events [default: 2048]
    streams: usize = "QUADRILLE_STREAMS";
    /// Most open streams of one client [default: 256]
    client_streams: usize = "QUADRILLE_CLIENT_STREAMS";
    /// Header by which a trusted proxy names the client [default: none, addresses count]
    client_header: String = "QUADRILLE_CLIENT_HEADER";
    /// How often a silent stream shows that it is alive [default: 15s]
    keep_alive: Span = "QUADRILLE_KEEP_ALIVE";
    /// Most bytes of a body [default: 16777216]
    max_body_bytes: usize = "QUADRILLE_MAX_BODY_BYTES";
    /// Most bytes of bodies that are being received or worked on [default: 536870912]
    bodies_bytes: usize = "QUADRILLE_BODIES_BYTES";
    /// Deepest nesting of JSON [default: 64]
    max_json_depth: usize = "QUADRILLE_MAX_JSON_DEPTH";
    /// Most arms of a workcell [default: 32]
    max_arms: usize = "QUADRILLE_MAX_ARMS";
    /// Most objects of a problem [default: 1000]
    max_objects: usize = "QUADRILLE_MAX_OBJECTS";
    /// Most obstacles of a workcell [default: 1000]
    max_obstacles: usize = "QUADRILLE_MAX_OBSTACLES";
    /// Most surfaces of a workcell [default: 200]
    max_surfaces: usize = "QUADRILLE_MAX_SURFACES";
    /// Most triangles of a mesh [default: 500000]
    max_triangles: usize = "QUADRILLE_MAX_TRIANGLES";
    /// Most threads of one job [default: the number of processors]
    max_threads: u64 = "QUADRILLE_MAX_THREADS";
    /// Time budget of a problem that has none [default: 30s]
    default_time_budget: Span = "QUADRILLE_DEFAULT_TIME_BUDGET";
    /// Greatest time budget [default: 1h]
    max_time_budget: Span = "QUADRILLE_MAX_TIME_BUDGET";
    /// Largest plan that events carry inline, in bytes [default: 1048576]
    inline_plan_bytes: usize = "QUADRILLE_INLINE_PLAN_BYTES";
    /// Most problems that are validated at once [default: the number of processors]
    validations: usize = "QUADRILLE_VALIDATIONS";
    /// Most registered workcells [default: 100]
    workcells: usize = "QUADRILLE_WORKCELLS";
    /// Most bytes of all registered workcells and their files [default: 1073741824]
    workcells_bytes: u64 = "QUADRILLE_WORKCELLS_BYTES";
    /// Most files of a bundle [default: 1000]
    bundle_entries: usize = "QUADRILLE_BUNDLE_ENTRIES";
    /// Most bytes of a bundle once unpacked [default: 134217728]
    bundle_unpacked_bytes: usize = "QUADRILLE_BUNDLE_UNPACKED_BYTES";
    /// Most ended jobs that are kept [default: 1000]
    retain_jobs: usize = "QUADRILLE_RETAIN_JOBS";
    /// Most bytes of the plans of ended jobs [default: 536870912]
    retain_plan_bytes: u64 = "QUADRILLE_RETAIN_PLAN_BYTES";
    /// How long an ended job is kept [default: 7d]
    retain_for: Span = "QUADRILLE_RETAIN_FOR";
    /// Most events that are kept of one job [default: 1000]
    job_events: u64 = "QUADRILLE_JOB_EVENTS";
    /// Most bytes of plans that are kept of one job [default: 67108864]
    job_plan_bytes: u64 = "QUADRILLE_JOB_PLAN_BYTES";
    /// How long a shutdown waits for what is under way [default: 10s]
    drain: Span = "QUADRILLE_DRAIN";
}

/// What a file holds beside the settings of the service.
#[derive(Debug, thiserror::Error)]
pub(super) enum SettingsError {
    /// It cannot be read.
    #[error("{path}: {why}", path = .0.display(), why = .1)]
    Unreadable(PathBuf, std::io::Error),
    /// It is no settings file.
    #[error("{path}: {why}", path = .0.display(), why = .1)]
    Unusable(PathBuf, String),
    /// A setting makes no sense.
    #[error("{0}: {1}")]
    Nonsense(&'static str, String),
}

impl Settings {
    /// The settings of a file, TOML, under these.
    pub(super) fn over_file(self, path: &Path) -> Result<Self, SettingsError> {
        let text = std::fs::read(path).map_err(|error| SettingsError::Unreadable(path.to_owned(), error))?;
        let unusable = |why: String| SettingsError::Unusable(path.to_owned(), why);
        if text.len() > LARGEST_FILE {
            return Err(unusable(format!("the file is larger than {LARGEST_FILE} bytes")));
        }
        let text = String::from_utf8(text).map_err(|_| unusable("the file is not UTF-8".to_owned()))?;
        let file: Self = toml::from_str(&text).map_err(|error| unusable(error.to_string()))?;
        Ok(self.or(file))
    }

    /// Where to listen.
    pub(super) fn address(&self) -> SocketAddr {
        self.listen.unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 8080)))
    }

    /// What is known of workcells when the service starts.
    pub(super) fn cache(&self) -> PlannerCache {
        match &self.cache_dir {
            Some(folder) => PlannerCache::default().with_folder(folder, self.cache_bytes),
            None => PlannerCache::default(),
        }
    }

    /// The service's configuration.
    pub(super) fn config(&self) -> Result<ServiceConfig, SettingsError> {
        let mut config = ServiceConfig::default();
        let set = |place: &mut usize, value: Option<usize>| *place = value.unwrap_or(*place);
        let span = |place: &mut Duration, value: Option<Span>| *place = value.map_or(*place, |span| span.0);
        config.data_dir.clone_from(&self.data_dir);
        set(&mut config.jobs.workers, self.workers);
        set(&mut config.jobs.queue_limit, self.queue_limit);
        config.jobs.client_limit = self.client_jobs.unwrap_or(config.jobs.queue_limit + config.jobs.workers);
        span(&mut config.jobs.aging, self.priority_aging);
        // Some files are the store's and the runtime's.
        let sockets = files_allowed().map_or(usize::MAX, |files| files.saturating_sub(OTHER_FILES).max(1));
        if let Some(given) = self.connections.filter(|given| *given > sockets) {
            let why = format!(
                "{given} are more than the {sockets} for which this process may open files; raise that limit \
                 (ulimit -n) or give a smaller number"
            );
            return Err(SettingsError::Nonsense("connections", why));
        }
        config.connections = self.connections.unwrap_or(config.connections.min(sockets));
        config.client_connections = self.client_connections.unwrap_or(config.connections.div_ceil(2));
        set(&mut config.streams, self.streams);
        set(&mut config.client_streams, self.client_streams);
        span(&mut config.keep_alive, self.keep_alive);
        span(&mut config.drain, self.drain);
        let read = &mut config.read_limits;
        set(&mut read.max_bytes, self.max_body_bytes);
        set(&mut read.max_json_depth, self.max_json_depth);
        set(&mut read.max_arms, self.max_arms);
        set(&mut read.max_objects, self.max_objects);
        set(&mut read.max_obstacles, self.max_obstacles);
        set(&mut read.max_surfaces, self.max_surfaces);
        set(&mut read.max_triangles, self.max_triangles);
        read.max_threads = self.max_threads.unwrap_or(read.max_threads).clamp(1, 64);
        let longest = self.max_time_budget.map_or(read.max_time_budget_s, |span| span.0.as_secs_f64());
        read.max_time_budget_s = longest;
        let usual = self.default_time_budget.map(|span| span.0.as_secs_f64());
        if let Some(usual) = usual.filter(|usual| *usual > longest) {
            let why = format!("{usual} s is more than the greatest time budget of {longest} s");
            return Err(SettingsError::Nonsense("default-time-budget", why));
        }
        read.default_time_budget_s = usual.unwrap_or(read.default_time_budget_s).min(longest);
        set(&mut config.bodies_bytes, self.bodies_bytes);
        set(&mut config.inline_plan_bytes, self.inline_plan_bytes);
        set(&mut config.validations, self.validations);
        set(&mut config.workcells, self.workcells);
        config.workcells_bytes = self.workcells_bytes.unwrap_or(config.workcells_bytes);
        set(&mut config.archive.entries, self.bundle_entries);
        set(&mut config.archive.unpacked_bytes, self.bundle_unpacked_bytes);
        let keep = &mut config.retention;
        set(&mut keep.jobs, self.retain_jobs);
        keep.plan_bytes = self.retain_plan_bytes.unwrap_or(keep.plan_bytes);
        span(&mut keep.age, self.retain_for);
        keep.job_events = self.job_events.unwrap_or(keep.job_events).max(3);
        keep.job_plan_bytes = self.job_plan_bytes.unwrap_or(keep.job_plan_bytes);
        if let Some(name) = &self.client_header {
            let header = name.parse().map_err(|_| {
                SettingsError::Nonsense("client-header", format!("`{name}` is no name of a header"))
            })?;
            config.client_header = Some(header);
        }
        check(&config)?;
        Ok(config)
    }
}

/// Whether settings make sense, alone and together.
///
/// # Errors
/// The first setting that makes none, and why.
fn check(config: &ServiceConfig) -> Result<(), SettingsError> {
    let (read, archive) = (&config.read_limits, &config.archive);
    for (name, value, most) in [
        ("workers", config.jobs.workers, 1024),
        ("client-jobs", config.jobs.client_limit, usize::MAX),
        ("connections", config.connections, 1 << 20),
        ("client-connections", config.client_connections, 1 << 20),
        ("streams", config.streams, 1 << 20),
        ("client-streams", config.client_streams, 1 << 20),
        ("validations", config.validations, 1024),
        ("max-body-bytes", read.max_bytes, 1 << 30),
        ("max-json-depth", read.max_json_depth, 127),
        ("max-arms", read.max_arms, 1000),
        ("max-objects", read.max_objects, 1_000_000),
        ("bundle-entries", archive.entries, 1_000_000),
    ] {
        if !(1..=most).contains(&value) {
            let most = if most == usize::MAX { "on".to_owned() } else { format!("to {most}") };
            return Err(SettingsError::Nonsense(
                name,
                format!("{value} makes no sense; give a number from 1 {most}"),
            ));
        }
    }
    if config.bodies_bytes < read.max_bytes {
        let why = format!(
            "{} bytes for all bodies are less than the {} that one may have (max-body-bytes)",
            config.bodies_bytes, read.max_bytes
        );
        return Err(SettingsError::Nonsense("bodies-bytes", why));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> Result<Settings, SettingsError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("quadrille.toml");
        std::fs::write(&path, text).unwrap();
        Settings { workers: Some(3), ..Settings::default() }.over_file(&path)
    }

    #[test]
    fn what_is_given_later_wins() {
        let settings = file("workers = 1\nqueue_limit = 9\ndrain = \"2m\"\nretain_for = \"2d\"\n").unwrap();
        let config = settings.config().unwrap();
        assert_eq!((config.jobs.workers, config.jobs.queue_limit, config.jobs.client_limit), (3, 9, 12));
        assert_eq!(config.drain, Duration::from_secs(120));
        assert_eq!(config.retention.age, Duration::from_secs(48 * 3600));
    }

    #[test]
    fn mistakes_are_told() {
        for bad in ["colour = 1", "workers = \"x\"", "drain = \"soon\"", "drain = 3", "["] {
            assert!(matches!(file(bad), Err(SettingsError::Unusable(..))), "{bad}");
        }
        for bad in [
            "client_header = \"a b\"",
            "streams = 0",
            "default_time_budget = \"2h\"",
            "max_body_bytes = 0",
            "bodies_bytes = 1000",
            "max_json_depth = 500",
            "connections = 999999999",
        ] {
            assert!(matches!(file(bad).unwrap().config(), Err(SettingsError::Nonsense(..))), "{bad}");
        }
    }

    #[test]
    fn an_example_file_stands_in_the_repository() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/quadrille.toml");
        let settings = Settings::default().over_file(&path).unwrap();
        let (given, usual) = (settings.config().unwrap(), ServiceConfig::default());
        assert_eq!(
            given.read_limits,
            crate::wire::ReadLimits { max_threads: given.read_limits.max_threads, ..usual.read_limits }
        );
        assert_eq!(given.streams, usual.streams);
        assert_eq!(given.bodies_bytes, usual.bodies_bytes);
    }
}
