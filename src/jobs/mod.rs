//! Jobs: a bounded queue, a bounded pool of planner threads, the state machine of each job, and
//! its durable events.
//!
//! The threads here are plain threads: this room knows no async runtime and no HTTP. Readers follow a
//! job through a [`Subscription`], which is a `futures::Stream` and so runs on whatever polls it.
//! What a job is at any moment is the fold of its durable events ([`JobRecord::apply`]), and those
//! live behind [`JobStore`]: [`EmbeddedStore`] keeps them in a file or in memory.

mod embedded;
mod event;
mod id;
mod keeper;
mod live;
mod observer;
mod planner;
mod pool;
mod queue;
mod record;
mod state;
mod store;
mod subscription;
mod timestamp;
mod worker;

pub use embedded::{EmbeddedStore, Retention};
pub use event::{Event, EventBody, Incumbent, Progress, RetryCause, Retrying, Snapshot, Terminal};
pub use id::{BadJobId, JobId};
pub use observer::{NoObserver, Observer, Occurrence};
pub use planner::{Planner, ProblemReader, SmartPlanner};
pub use pool::{Cancelled, Jobs, JobsConfig, Load, Parts, Submission, Ticket};
pub use queue::QueueRefusal;
pub use record::{Best, JobRecord};
pub use state::{JobState, TerminationReason};
pub use store::{Idempotency, JobRequest, JobStore, Lease, ListQuery, NewJob, Revision, StoreError};
pub use subscription::{Delivery, Subscription};
pub use timestamp::Timestamp;
