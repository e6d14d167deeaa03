//! The states of a job, and why it ended (FORMAT "Job").

/// Where a job is in its life: `QUEUED -> RUNNING ->` an end, from `QUEUED` straight to `CANCELLED` or
/// `EXPIRED`, and from `RUNNING` back to `QUEUED` when an attempt is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobState {
    /// It waits for a planner thread.
    Queued,
    /// A planner thread works on it.
    Running,
    /// It ended with a plan.
    Succeeded,
    /// It ended without a plan, or by a fault of ours.
    Failed,
    /// Someone cancelled it; its best plan is kept.
    Cancelled,
    /// It waited longer than it was allowed to.
    Expired,
}

impl JobState {
    /// Every state.
    pub const ALL: [JobState; 6] = [
        JobState::Queued,
        JobState::Running,
        JobState::Succeeded,
        JobState::Failed,
        JobState::Cancelled,
        JobState::Expired,
    ];

    /// The state of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }

    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            JobState::Queued => "QUEUED",
            JobState::Running => "RUNNING",
            JobState::Succeeded => "SUCCEEDED",
            JobState::Failed => "FAILED",
            JobState::Cancelled => "CANCELLED",
            JobState::Expired => "EXPIRED",
        }
    }

    /// Whether nothing happens any more.
    pub fn is_terminal(self) -> bool {
        !matches!(self, JobState::Queued | JobState::Running)
    }
}

/// Why a job ended. The reason determines the state, so the two cannot disagree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TerminationReason {
    /// The budget ended with a plan in hand.
    TimeLimit,
    /// The objective `steps` is proved to be at its least.
    Optimal,
    /// `stop.target_duration_s` was reached.
    TargetReached,
    /// `stop.first_solution` was asked for.
    FirstSolution,
    /// `stop.no_improvement_s` passed.
    NoImprovement,
    /// No plan exists.
    Infeasible,
    /// The budget ended without a plan.
    NoSolutionFound,
    /// A fault of ours.
    Internal,
    /// The processes that ran it were lost time and again.
    WorkerLost,
    /// A client cancelled it.
    ClientCancel,
    /// `queue_ttl_s` passed before it started.
    QueueTimeout,
}

impl TerminationReason {
    /// Every reason.
    pub const ALL: [TerminationReason; 11] = [
        TerminationReason::TimeLimit,
        TerminationReason::Optimal,
        TerminationReason::TargetReached,
        TerminationReason::FirstSolution,
        TerminationReason::NoImprovement,
        TerminationReason::Infeasible,
        TerminationReason::NoSolutionFound,
        TerminationReason::Internal,
        TerminationReason::WorkerLost,
        TerminationReason::ClientCancel,
        TerminationReason::QueueTimeout,
    ];

    /// The reason of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| reason.as_str() == name)
    }

    /// The state that a job with this reason is in.
    pub fn state(self) -> JobState {
        use TerminationReason as R;
        match self {
            R::TimeLimit | R::Optimal | R::TargetReached | R::FirstSolution | R::NoImprovement => {
                JobState::Succeeded
            }
            R::Infeasible | R::NoSolutionFound | R::Internal | R::WorkerLost => JobState::Failed,
            R::ClientCancel => JobState::Cancelled,
            R::QueueTimeout => JobState::Expired,
        }
    }

    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        use TerminationReason as R;
        match self {
            R::TimeLimit => "TIME_LIMIT",
            R::Optimal => "OPTIMAL",
            R::TargetReached => "TARGET_REACHED",
            R::FirstSolution => "FIRST_SOLUTION",
            R::NoImprovement => "NO_IMPROVEMENT",
            R::Infeasible => "INFEASIBLE",
            R::NoSolutionFound => "NO_SOLUTION_FOUND",
            R::Internal => "INTERNAL",
            R::WorkerLost => "WORKER_LOST",
            R::ClientCancel => "CLIENT_CANCEL",
            R::QueueTimeout => "QUEUE_TIMEOUT",
        }
    }
}
