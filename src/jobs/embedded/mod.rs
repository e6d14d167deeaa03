//! The store of one process: redb, in a file below the data directory or in memory.
//!
//! redb, and not SQLite or an LSM tree, because it is plain Rust that builds in seconds, keeps one
//! file that survives `kill -9` at any instant (copy-on-write pages, one checksummed commit slot
//! that is synced last, no log to replay), and lets readers go on while a writer commits. What is
//! stored is small and read mostly by key, so SQL would serve nothing here.
//!
//! Every commit is synced before [`JobStore::append`] returns. The file is locked by the process
//! that has it open, so leases that an earlier process left behind are void.

mod codec;
mod file;
mod loaned;
mod tables;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use redb::backends::InMemoryBackend;
use redb::{Database, ReadTransaction, ReadableDatabase, ReadableTable, WriteTransaction};

use self::codec::{
    Kept, decode_event, decode_record, decode_request, encode_event, encode_record, encode_request,
};
use self::loaned::Loaned;
use self::tables::{EVENTS, KEYS, LEASES, PLANS, PROBLEMS, RECORDS, REQUESTS, broken};
use super::{
    Event, EventBody, Incumbent, JobId, JobRecord, JobRequest, JobState, JobStore, Lease, ListQuery, NewJob,
    Revision, StoreError, Timestamp,
};

/// Pages that redb keeps in memory (bytes).
const CACHE: usize = 64 << 20;
/// Most events of one job that are kept at hand, and most bytes of their plans.
const TAIL_EVENTS: usize = 64;
const TAIL_BYTES: usize = 4 << 20;
/// Bytes of plans after which no more events are read from the file at once.
const READ_BYTES: usize = 1 << 20;

/// How much the store remembers. Jobs that have not ended are always kept.
#[derive(Debug, Clone, Copy)]
pub struct Retention {
    /// Most ended jobs.
    pub jobs: usize,
    /// Most bytes of the plans of ended jobs.
    pub plan_bytes: u64,
    /// How long an ended job is kept.
    pub age: Duration,
    /// Most events of one job; the oldest are trimmed first.
    pub job_events: u64,
    /// Most bytes of one job's plans; the oldest are trimmed first, the best never.
    pub job_plan_bytes: u64,
}

impl Default for Retention {
    fn default() -> Self {
        Self {
            jobs: 1000,
            plan_bytes: 512 << 20,
            age: Duration::from_secs(7 * 24 * 3600),
            job_events: 1000,
            job_plan_bytes: 64 << 20,
        }
    }
}

/// A [`JobStore`] in one file or in memory.
pub struct EmbeddedStore {
    database: Arc<Database>,
    retention: Retention,
    /// Held by whoever changes anything, over the commit and what is in memory.
    writing: Mutex<()>,
    /// What is in memory. Never held over a commit, so that readers do not wait for the disk.
    inner: Mutex<Inner>,
    loaned: Loaned,
    /// Why the last thing could not be written. After a failure of the disk redb refuses all else.
    failure: Mutex<Option<String>>,
}

#[derive(Default)]
struct Inner {
    /// Jobs that have not ended.
    open: BTreeMap<JobId, Open>,
    /// Ended jobs in the order in which they ended, with the bytes of their plans.
    ended: BTreeMap<(Timestamp, JobId), u64>,
    ended_bytes: u64,
}

struct Open {
    kept: Kept,
    /// The newest events.
    tail: VecDeque<Arc<Event>>,
    tail_bytes: usize,
    /// Whether a thread of this process runs it.
    leased: bool,
}

impl Open {
    fn new(kept: Kept) -> Self {
        Self { kept, tail: VecDeque::new(), tail_bytes: 0, leased: false }
    }

    fn push(&mut self, event: Arc<Event>) {
        self.tail_bytes += document_bytes(&event);
        self.tail.push_back(event);
        while self.tail.len() > 1 && (self.tail.len() > TAIL_EVENTS || self.tail_bytes > TAIL_BYTES) {
            if let Some(gone) = self.tail.pop_front() {
                self.tail_bytes -= document_bytes(&gone);
            }
        }
    }
}

fn document_bytes(event: &Event) -> usize {
    match &event.body {
        EventBody::Incumbent(incumbent) => incumbent.document.len(),
        _ => 0,
    }
}

impl EmbeddedStore {
    /// A store that forgets everything when the process ends.
    ///
    /// # Errors
    /// When the store cannot be made.
    pub fn in_memory(retention: Retention) -> Result<Self, StoreError> {
        let database = Database::builder()
            .set_cache_size(CACHE)
            .create_with_backend(InMemoryBackend::new())
            .map_err(broken)?;
        Self::over(database, retention)
    }

    /// The store in `folder`, made when there is none.
    ///
    /// # Errors
    /// When the folder cannot be used, or another process has the store open.
    pub fn open(folder: &Path, retention: Retention) -> Result<Self, StoreError> {
        let database = file::open(folder, CACHE)?;
        Self::over(database, retention)
    }

    fn over(database: Database, retention: Retention) -> Result<Self, StoreError> {
        tables::create(&database)?;
        let mut inner = Inner::default();
        let read = database.begin_read().map_err(broken)?;
        for entry in read.open_table(RECORDS).map_err(broken)?.iter().map_err(broken)? {
            let (key, value) = entry.map_err(broken)?;
            let id = JobId::from_u128(key.value());
            let kept = decode_record(id, value.value())?;
            match kept.record.finished_at {
                Some(at) => {
                    inner.ended_bytes += kept.plan_bytes;
                    inner.ended.insert((at, id), kept.plan_bytes);
                }
                None => {
                    inner.open.insert(id, Open::new(kept));
                }
            }
        }
        drop(read);
        Ok(Self {
            database: Arc::new(database),
            retention,
            writing: Mutex::default(),
            inner: Mutex::new(inner),
            loaned: Loaned::default(),
            failure: Mutex::default(),
        })
    }

    /// The database, for what else is kept in the same file.
    pub fn database(&self) -> Arc<Database> {
        Arc::clone(&self.database)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // What is in memory changes only after a commit, in steps that do not panic.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin(&self) -> MutexGuard<'_, ()> {
        self.writing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self) -> Result<ReadTransaction, StoreError> {
        self.database.begin_read().map_err(broken)
    }

    fn write<T>(
        &self,
        act: impl FnOnce(&WriteTransaction) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let written = || {
            let transaction = self.database.begin_write().map_err(broken)?;
            let value = act(&transaction)?;
            transaction.commit().map_err(broken)?;
            Ok(value)
        };
        let result = written();
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        match &result {
            Ok(_) => *failure = None,
            // What came first is the cause of what follows.
            Err(StoreError::Broken(why)) if failure.is_none() => *failure = Some(why.clone()),
            Err(_) => {}
        }
        result
    }

    fn kept(&self, job: JobId) -> Result<Kept, StoreError> {
        if let Some(open) = self.lock().open.get(&job) {
            return Ok(open.kept.clone());
        }
        let read = self.read()?;
        let table = read.open_table(RECORDS).map_err(broken)?;
        let value = table.get(job.as_u128()).map_err(broken)?.ok_or(StoreError::UnknownJob(job))?;
        decode_record(job, value.value())
    }

    fn forget(&self, job: JobId) -> Result<(), StoreError> {
        self.write(|transaction| tables::forget(transaction, job))
    }

    /// Removes the oldest events while the job has too many, or too large plans; never the newest
    /// incumbent or what follows it.
    fn trim(&self, transaction: &WriteTransaction, kept: &mut Kept, newest: u64) -> Result<(), StoreError> {
        let id = kept.record.id.as_u128();
        let mut events = transaction.open_table(EVENTS).map_err(broken)?;
        let mut plans = transaction.open_table(PLANS).map_err(broken)?;
        loop {
            let oldest = kept.record.trimmed + 1;
            let many = newest + 1 - oldest > self.retention.job_events;
            if oldest >= newest || !(many || kept.plan_bytes > self.retention.job_plan_bytes) {
                return Ok(());
            }
            let mut freed = 0;
            if let Some(value) = events.remove((id, oldest)).map_err(broken)? {
                let event = decode_event(kept.record.id, oldest, value.value(), |_| Ok("".into()))?;
                if let EventBody::Incumbent(incumbent) = event.body
                    && let Some(plan) = plans.remove((id, incumbent.revision)).map_err(broken)?
                {
                    freed = plan.value().len() as u64;
                }
            }
            kept.plan_bytes = kept.plan_bytes.saturating_sub(freed);
            kept.record.trimmed = oldest;
        }
    }
}

impl JobStore for EmbeddedStore {
    fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn create(&self, job: NewJob) -> Result<JobRecord, StoreError> {
        let _writing = self.begin();
        let id = job.id.as_u128();
        let mut kept = Kept {
            record: JobRecord::new(&job),
            plan_bytes: 0,
            key: job.request.idempotency.as_ref().map(|own| own.key.clone()),
        };
        let body = EventBody::Queued { position: job.position };
        let event = Arc::new(Event { seq: 1, job: job.id, attempt: 1, at: job.created_at, body });
        kept.record.apply(&event);
        self.write(|transaction| {
            if let Some(own) = &job.request.idempotency {
                let mut keys = transaction.open_table(KEYS).map_err(broken)?;
                if let Some(taken) = keys.get(own.key.as_str()).map_err(broken)? {
                    let (job, digest) = taken.value();
                    return Err(StoreError::KeyTaken {
                        job: JobId::from_u128(job),
                        digest: digest.to_owned(),
                    });
                }
                keys.insert(own.key.as_str(), (id, own.digest.as_str())).map_err(broken)?;
            }
            let mut problems = transaction.open_table(PROBLEMS).map_err(broken)?;
            problems.insert(id, &*job.request.problem).map_err(broken)?;
            let mut requests = transaction.open_table(REQUESTS).map_err(broken)?;
            requests.insert(id, encode_request(&job.request).as_slice()).map_err(broken)?;
            tables::put(transaction, RECORDS, id, &encode_record(&kept))?;
            let mut events = transaction.open_table(EVENTS).map_err(broken)?;
            events.insert((id, 1), encode_event(&event).as_slice()).map_err(broken)?;
            Ok(())
        })?;
        let record = kept.record.clone();
        let mut open = Open::new(kept);
        open.push(event);
        self.lock().open.insert(job.id, open);
        Ok(record)
    }

    fn keyed(&self, key: &str) -> Result<Option<(JobId, String)>, StoreError> {
        let read = self.read()?;
        let keys = read.open_table(KEYS).map_err(broken)?;
        let found = keys.get(key).map_err(broken)?;
        Ok(found.map(|value| {
            let (job, digest) = value.value();
            (JobId::from_u128(job), digest.to_owned())
        }))
    }

    fn lease(&self, job: JobId, now: Timestamp, _until: Timestamp) -> Result<Lease, StoreError> {
        let _writing = self.begin();
        if self.lock().open.get(&job).is_some_and(|open| open.leased) {
            return Err(StoreError::Leased(job));
        }
        let record = self.kept(job)?.record;
        if record.state != JobState::Queued {
            return Err(StoreError::OutOfTurn { job, state: record.state, event: "started" });
        }
        self.write(|transaction| tables::sign_of_life(transaction, job.as_u128(), now))?;
        if let Some(open) = self.lock().open.get_mut(&job) {
            open.leased = true;
        }
        Ok(Lease { job, attempt: record.attempt })
    }

    fn renew(&self, lease: Lease, now: Timestamp, _until: Timestamp) -> Result<(), StoreError> {
        let _writing = self.begin();
        let job = lease.job;
        self.check_lease(lease)?;
        self.write(|transaction| tables::sign_of_life(transaction, job.as_u128(), now))
    }

    fn abandoned(&self, _now: Timestamp) -> Result<Vec<(JobRecord, Timestamp)>, StoreError> {
        let inner = self.lock();
        let read = self.read()?;
        let leases = read.open_table(LEASES).map_err(broken)?;
        let lost = inner.open.values().filter(|open| {
            // A lease of this very process holds for as long as someone can ask.
            open.kept.record.state == JobState::Running && !open.leased
        });
        lost.map(|open| {
            let record = open.kept.record.clone();
            let alive = leases.get(record.id.as_u128()).map_err(broken)?.map(|value| value.value());
            let alive = Timestamp::from_unix_millis(alive.unwrap_or(0));
            let last = self.events_of(&read, record.id, record.last_seq - 1, 1)?;
            let last = last.last().map_or(alive, |event| event.at);
            Ok((record, alive.max(last)))
        })
        .collect()
    }

    fn waiting(&self) -> Result<Vec<JobRecord>, StoreError> {
        let inner = self.lock();
        let waiting = inner.open.values().filter(|open| open.kept.record.state == JobState::Queued);
        Ok(waiting.map(|open| open.kept.record.clone()).collect())
    }

    fn append(
        &self,
        job: JobId,
        lease: Option<Lease>,
        at: Timestamp,
        body: EventBody,
    ) -> Result<Arc<Event>, StoreError> {
        let _writing = self.begin();
        let mut kept = self.kept(job)?;
        let record = &kept.record;
        if let Some(lease) = lease.filter(|_| !record.state.is_terminal()) {
            self.check_lease(lease)?;
        }
        if !record.admits(&body) {
            return Err(StoreError::OutOfTurn { job, state: record.state, event: body.kind() });
        }
        let attempt = match &body {
            EventBody::Retrying(retrying) => retrying.attempt,
            _ => record.attempt,
        };
        let event = Arc::new(Event { seq: record.last_seq + 1, job, attempt, at, body });
        kept.record.apply(&event);
        kept.plan_bytes += document_bytes(&event) as u64;
        let id = job.as_u128();
        self.write(|transaction| {
            let mut events = transaction.open_table(EVENTS).map_err(broken)?;
            events.insert((id, event.seq), encode_event(&event).as_slice()).map_err(broken)?;
            drop(events);
            if let EventBody::Incumbent(incumbent) = &event.body {
                let mut plans = transaction.open_table(PLANS).map_err(broken)?;
                plans.insert((id, incumbent.revision), incumbent.document.as_bytes()).map_err(broken)?;
                drop(plans);
                self.trim(transaction, &mut kept, event.seq)?;
            }
            if !matches!(event.body, EventBody::Started | EventBody::Incumbent(_)) {
                let mut leases = transaction.open_table(LEASES).map_err(broken)?;
                leases.remove(id).map_err(broken)?;
            }
            if kept.record.state.is_terminal() {
                // Nobody runs it again: what was asked for would only take room.
                tables::forget_request(transaction, id)?;
            }
            tables::put(transaction, RECORDS, id, &encode_record(&kept))
        })?;
        let mut inner = self.lock();
        if kept.record.state.is_terminal() {
            inner.open.remove(&job);
            inner.ended.insert((at, job), kept.plan_bytes);
            inner.ended_bytes += kept.plan_bytes;
            drop(inner);
            self.forget_surplus(at)?;
        } else if let Some(open) = inner.open.get_mut(&job) {
            open.leased &= !matches!(event.body, EventBody::Retrying(_));
            open.kept = kept;
            open.push(Arc::clone(&event));
        }
        Ok(event)
    }

    fn record(&self, job: JobId) -> Result<JobRecord, StoreError> {
        Ok(self.kept(job)?.record)
    }

    fn request(&self, job: JobId) -> Result<JobRequest, StoreError> {
        let record = self.record(job)?;
        let read = self.read()?;
        let id = job.as_u128();
        let gone = StoreError::UnknownJob(job);
        let problems = read.open_table(PROBLEMS).map_err(broken)?;
        let problem = problems.get(id).map_err(broken)?.ok_or(gone.clone())?;
        let requests = read.open_table(REQUESTS).map_err(broken)?;
        let request = requests.get(id).map_err(broken)?.ok_or(gone)?;
        decode_request(request.value(), problem.value(), &record)
    }

    fn list(&self, query: &ListQuery) -> Result<Vec<JobRecord>, StoreError> {
        let read = self.read()?;
        let table = read.open_table(RECORDS).map_err(broken)?;
        let end = query.before.map_or(u128::MAX, JobId::as_u128);
        let mut found = Vec::new();
        for entry in table.range(..end).map_err(broken)?.rev() {
            if found.len() >= query.limit {
                break;
            }
            let (key, value) = entry.map_err(broken)?;
            let record = decode_record(JobId::from_u128(key.value()), value.value())?.record;
            if query.matches(&record) {
                found.push(record);
            }
        }
        Ok(found)
    }

    fn events_after(&self, job: JobId, after: u64, limit: usize) -> Result<Vec<Arc<Event>>, StoreError> {
        if let Some(open) = self.lock().open.get(&job) {
            let first = open.tail.front().map_or(u64::MAX, |event| event.seq);
            if after >= open.kept.record.last_seq {
                return Ok(Vec::new());
            }
            if after + 1 >= first {
                let newer = open.tail.iter().filter(|event| event.seq > after);
                return Ok(newer.take(limit).cloned().collect());
            }
        }
        let read = self.read()?;
        let events = self.events_of(&read, job, after, limit)?;
        if events.is_empty() {
            self.kept(job)?;
        }
        Ok(events)
    }

    fn solution(&self, job: JobId, revision: Revision) -> Result<Option<Incumbent>, StoreError> {
        let record = self.record(job)?;
        let read = self.read()?;
        let wanted = match (revision, &record.best) {
            (_, None) => return Ok(None),
            (Revision::Best, Some(best)) => best.revision,
            (Revision::Number(number), Some(best)) if number > best.revision => return Ok(None),
            (Revision::Number(number), Some(_)) => number,
        };
        if let Some(best) = record.best.filter(|best| best.revision == wanted) {
            let plans = read.open_table(PLANS).map_err(broken)?;
            let plan = plans.get((job.as_u128(), wanted)).map_err(broken)?;
            return plan
                .map(|plan| {
                    let document = text(plan.value())?;
                    Ok(Incumbent { revision: wanted, metrics: best.metrics, document })
                })
                .transpose();
        }
        // Which event it came with is not written down: an older revision is looked for.
        let mut after = record.trimmed;
        loop {
            let events = self.events_of(&read, job, after, TAIL_EVENTS)?;
            let Some(last) = events.last() else { return Ok(None) };
            after = last.seq;
            for event in events {
                if let EventBody::Incumbent(incumbent) = &event.body
                    && incumbent.revision == wanted
                {
                    return Ok(Some(incumbent.clone()));
                }
            }
        }
    }

    fn delete(&self, job: JobId) -> Result<(), StoreError> {
        let _writing = self.begin();
        let Some(at) = self.kept(job)?.record.finished_at else { return Err(StoreError::NotEnded(job)) };
        self.forget(job)?;
        self.lock().let_go(at, job);
        Ok(())
    }

    fn sweep(&self, now: Timestamp) -> Result<(), StoreError> {
        let _writing = self.begin();
        self.forget_surplus(now)
    }
}

fn text(bytes: &[u8]) -> Result<Arc<str>, StoreError> {
    std::str::from_utf8(bytes).map(Arc::from).map_err(broken)
}

impl Inner {
    /// The ended job that is to go next, if any.
    fn surplus(&self, retention: &Retention, now: Timestamp) -> Option<(Timestamp, JobId)> {
        let (&(at, job), _) = self.ended.first_key_value()?;
        let surplus = self.ended.len() > retention.jobs
            || (self.ended_bytes > retention.plan_bytes && self.ended.len() > 1)
            || now.since(at) > retention.age;
        surplus.then_some((at, job))
    }

    fn let_go(&mut self, at: Timestamp, job: JobId) {
        if let Some(bytes) = self.ended.remove(&(at, job)) {
            self.ended_bytes -= bytes;
        }
    }
}

impl EmbeddedStore {
    /// Whether a lease still holds; to be called while nobody else writes.
    fn check_lease(&self, lease: Lease) -> Result<(), StoreError> {
        let inner = self.lock();
        let open = inner.open.get(&lease.job).ok_or(StoreError::UnknownJob(lease.job))?;
        if open.leased && open.kept.record.attempt == lease.attempt {
            return Ok(());
        }
        Err(StoreError::Fenced { job: lease.job, attempt: lease.attempt })
    }

    /// Forgets ended jobs beyond what is kept; to be called while nobody else writes.
    fn forget_surplus(&self, now: Timestamp) -> Result<(), StoreError> {
        loop {
            let Some((at, job)) = self.lock().surplus(&self.retention, now) else { return Ok(()) };
            self.forget(job)?;
            self.lock().let_go(at, job);
        }
    }

    fn events_of(
        &self,
        read: &ReadTransaction,
        job: JobId,
        after: u64,
        limit: usize,
    ) -> Result<Vec<Arc<Event>>, StoreError> {
        let id = job.as_u128();
        let table = read.open_table(EVENTS).map_err(broken)?;
        let plans = read.open_table(PLANS).map_err(broken)?;
        let range = (id, after.saturating_add(1))..=(id, u64::MAX);
        let (mut events, mut bytes) = (Vec::new(), 0);
        for entry in table.range(range).map_err(broken)?.take(limit) {
            if bytes > READ_BYTES {
                break;
            }
            let (key, value) = entry.map_err(broken)?;
            let plan = |revision| {
                let plan = plans.get((id, revision)).map_err(broken)?;
                let plan = plan.ok_or_else(|| StoreError::Broken(format!("no plan {revision}")))?;
                text(plan.value())
            };
            let seq = key.value().1;
            let event = self.loaned.get(job, seq, || decode_event(job, seq, value.value(), plan))?;
            bytes += document_bytes(&event);
            events.push(event);
        }
        Ok(events)
    }
}

#[cfg(test)]
mod tests;
