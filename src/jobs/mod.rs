//! Jobs: a bounded queue, a bounded pool of planner threads, the state machine of each job, and
//! its durable events.
//!
//! The threads here are plain threads: this room knows no async runtime and no HTTP. Readers follow a
//! job through a [`Subscription`], which is a `futures::Stream` and so runs on whatever polls it.
//! What a job is at any moment is the fold of its durable events ([`JobRecord::apply`]), and those
//! live behind [`JobStore`]: this version keeps them in memory ([`MemoryStore`]).

mod event;
mod id;
mod live;
mod memory_store;
mod planner;
mod pool;
mod record;
mod state;
mod store;
mod subscription;
mod timestamp;

pub use event::{Event, EventBody, Incumbent, Progress, Terminal};
pub use id::{BadJobId, JobId};
pub use memory_store::{MemoryStore, Retention};
pub use planner::{Planner, SmartPlanner};
pub use pool::{Cancelled, Jobs, JobsConfig, Load, QueueRefusal, Submission, Ticket};
pub use record::{Best, JobRecord};
pub use state::{JobState, TerminationReason};
pub use store::{JobStore, NewJob, Revision, StoreError};
pub use subscription::{Delivery, Subscription};
pub use timestamp::Timestamp;
