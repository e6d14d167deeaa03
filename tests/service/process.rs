//! A service in a process of its own, which can be killed: this very test binary, asked to serve.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Seek as _};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use quadrille::service::{self, ServiceConfig};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::script;

/// Names the data directory to the child, and tells it that it is one.
const FOLDER: &str = "QUADRILLE_TEST_DATA_DIR";
/// How long anything may take before a test gives up, however busy the machine is.
pub const PATIENCE: Duration = Duration::from_secs(600);

/// Whether the long forms are asked for.
pub fn soak() -> bool {
    std::env::var_os("QUADRILLE_SOAK").is_some()
}

/// A service in a process of its own; killed when dropped.
pub struct Process {
    pub address: SocketAddr,
    child: Child,
    /// Kept open: who writes into a closed pipe is ended by that.
    _output: BufReader<ChildStdout>,
    words: Option<std::fs::File>,
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// The product; `QUADRILLE_BINARY` names a copy that nobody builds anew meanwhile.
fn product() -> OsString {
    std::env::var_os("QUADRILLE_BINARY").unwrap_or_else(|| env!("CARGO_BIN_EXE_quadrille").into())
}

impl Process {
    /// Starts a service with the scripted planner, which keeps its jobs in `folder`.
    pub fn start(folder: &Path) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "process::serves_when_asked_to", "--nocapture"]).env(FOLDER, folder);
        // No pipe of the test's own, which a process left alone would keep open.
        let words = tempfile::tempfile().unwrap();
        let mut process = Self::spawn_logging(command, words.try_clone().unwrap().into());
        process.words = Some(words);
        process
    }

    /// What it said on stderr, where that was kept.
    pub fn last_words(&mut self) -> String {
        let mut said = String::new();
        if let Some(words) = &mut self.words {
            words.rewind().and_then(|()| words.read_to_string(&mut said)).unwrap();
        }
        said
    }

    /// Starts the product itself.
    pub fn product(arguments: &[&str]) -> Self {
        let mut command = Command::new(product());
        command.args(["serve", "--listen", "127.0.0.1:0"]).args(arguments).env("QUADRILLE_LOG", "error");
        Self::spawn(command)
    }

    /// The product itself, whose log goes into a file as JSON.
    pub fn logged(arguments: &[&str], log: &Path) -> Self {
        let mut command = Command::new(product());
        command.args(["serve", "--listen", "127.0.0.1:0", "--log-format", "json"]).args(arguments);
        command.env_remove("QUADRILLE_LOG");
        Self::spawn_logging(command, std::fs::File::create(log).unwrap().into())
    }

    /// The product itself, on a disk that takes files of at most `kib` KiB.
    pub fn product_on_a_small_disk(arguments: &[&str], kib: u32) -> Self {
        let mut command = Command::new("bash");
        // The signal that goes with the limit is ignored, which leaves an error of the write.
        command.args(["-c", "trap '' XFSZ; ulimit -f $0 && exec \"$@\"", &kib.to_string()]);
        command.arg(product()).args(["serve", "--listen", "127.0.0.1:0"]);
        command.args(arguments).env("QUADRILLE_LOG", "error");
        Self::spawn(command)
    }

    fn spawn(command: Command) -> Self {
        Self::spawn_logging(command, Stdio::null())
    }

    fn spawn_logging(mut command: Command, log: Stdio) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        // What the test runner prints may stand before it on the line.
        let address = output.by_ref().lines().map_while(Result::ok).find_map(|line| {
            line.split_once("listening on ").map(|(_, address)| address.trim().parse().unwrap())
        });
        Self { address: address.expect("the service listens"), child, _output: output, words: None }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    /// `kill -9`.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// SIGTERM.
    pub fn terminate(&self) {
        let told = Command::new("kill").args(["-TERM", &self.id().to_string()]).status();
        assert!(told.unwrap().success());
    }

    /// Waits for the end.
    pub fn wait(&mut self) -> ExitStatus {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(began.elapsed() < PATIENCE, "the process does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether it has ended by itself.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Memory that it holds (bytes).
    pub fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("0 kB");
        line.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap_or(0) * 1024
    }

    /// Time (s) that planner threads have had a processor, that they were ready and had none, and that all other threads have had
    /// one.
    pub fn times(&self) -> (f64, f64, f64) {
        let (mut ran, mut waited, mut others) = (0.0, 0.0, 0.0);
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.id()));
        for task in tasks.into_iter().flatten().flatten().map(|task| task.path()) {
            let name = std::fs::read_to_string(task.join("comm")).unwrap_or_default();
            let times = std::fs::read_to_string(task.join("schedstat")).unwrap_or_default();
            let mut times = times.split(' ').map(|word| word.parse::<f64>().unwrap_or(0.0) / 1e9);
            if name.starts_with("planner") {
                ran += times.next().unwrap_or(0.0);
                waited += times.next().unwrap_or(0.0);
            } else {
                others += times.next().unwrap_or(0.0);
            }
        }
        (ran, waited, others)
    }

    /// Durable events of a job, once it has ended.
    pub async fn durable(&self, client: &reqwest::Client, job: &str) -> Vec<Value> {
        let reply = client.get(self.url(&format!("{job}/events"))).send().await.unwrap();
        assert_eq!(reply.status(), 200, "{job}");
        let events = crate::server::lines(&reply.text().await.unwrap());
        events.into_iter().filter(|event| event["type"] != "progress").collect()
    }
}

/// No test: what the child process runs.
#[test]
fn serves_when_asked_to() {
    let Some(folder) = std::env::var_os(FOLDER) else { return };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async move {
        let mut config = ServiceConfig { data_dir: Some(folder.into()), ..ServiceConfig::default() };
        config.jobs.workers = 2;
        config.jobs.queue_limit = 1000;
        config.jobs.client_limit = usize::MAX;
        // Whoever asks for all jobs in the end shall find them.
        config.retention.jobs = usize::MAX;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        println!("listening on {}", listener.local_addr().unwrap());
        let shutdown = CancellationToken::new();
        let raised = shutdown.clone();
        let mut terminated = signal(SignalKind::terminate()).unwrap();
        tokio::spawn(async move {
            terminated.recv().await;
            raised.cancel();
        });
        service::serve(listener, config, Arc::new(script::plan), shutdown).await.unwrap();
    });
}
