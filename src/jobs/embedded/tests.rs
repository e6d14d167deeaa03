use super::*;
use crate::jobs::{Idempotency, JobState, Progress, RetryCause, Retrying, Terminal, TerminationReason};
use crate::plan::{Metrics, StepsProof};

fn metrics() -> Metrics {
    Metrics {
        duration_s: 2.0,
        duration_synchronous_s: 2.0,
        arc_length: 1.0 / 3.0,
        actions: 2,
        steps: 2,
        mode_graph_optimum: None,
        steps_lower_bound: 2,
        steps_proof: StepsProof::Ilp,
        found_after_s: 0.1,
    }
}

fn incumbent(revision: u64, bytes: usize) -> EventBody {
    EventBody::Incumbent(Incumbent { revision, metrics: metrics(), document: "x".repeat(bytes).into() })
}

fn end() -> EventBody {
    let reason = TerminationReason::TimeLimit;
    EventBody::Terminal(Terminal { reason, metrics: Some(metrics()), diagnosis: None })
}

fn lost(attempt: u32) -> EventBody {
    let spent = Duration::from_millis(700);
    EventBody::Retrying(Retrying { attempt, cause: RetryCause::WorkerLost, spent })
}

fn memory() -> EmbeddedStore {
    EmbeddedStore::in_memory(Retention::default()).unwrap()
}

fn new(request: JobRequest) -> NewJob {
    NewJob { id: JobId::fresh(), created_at: Timestamp::now(), position: 1, request }
}

fn created(store: &EmbeddedStore) -> JobId {
    store.create(new(JobRequest::default())).unwrap().id
}

fn started(store: &EmbeddedStore) -> (JobId, Lease) {
    let id = created(store);
    let now = Timestamp::now();
    let lease = store.lease(id, now, now.plus(Duration::from_secs(9))).unwrap();
    store.append(id, Some(lease), now, EventBody::Started).unwrap();
    (id, lease)
}

fn all(limit: usize) -> ListQuery {
    ListQuery { limit, ..ListQuery::default() }
}

#[test]
fn events_are_numbered_without_gaps_and_the_record_is_their_fold() {
    let store = memory();
    let at = Timestamp::now();
    let job = new(JobRequest { priority: 3, ..JobRequest::default() });
    let id = store.create(job.clone()).unwrap().id;
    let lease = store.lease(id, at, at).unwrap();
    store.append(id, Some(lease), at, EventBody::Started).unwrap();
    store.append(id, Some(lease), at, incumbent(1, 3)).unwrap();
    store.append(id, None, at, lost(2)).unwrap();
    let lease = store.lease(id, at, at).unwrap();
    store.append(id, Some(lease), at, EventBody::Started).unwrap();
    store.append(id, Some(lease), at, incumbent(2, 3)).unwrap();
    // Before and after the end, from memory and from the file.
    for last in [6, 7] {
        let events = store.events_after(id, 0, 100).unwrap();
        assert_eq!(events.iter().map(|event| event.seq).collect::<Vec<_>>(), (1..=last).collect::<Vec<_>>());
        assert_eq!(store.events_after(id, 3, 1).unwrap()[0].seq, 4);
        assert!(store.events_after(id, u64::MAX, 1).unwrap().is_empty());
        let mut folded = JobRecord::new(&job);
        events.iter().for_each(|event| folded.apply(event));
        assert_eq!(folded, store.record(id).unwrap());
        assert_eq!(folded.spent, Duration::from_millis(700));
        let _ = store.append(id, Some(lease), at, end());
    }
    assert_eq!(store.record(id).unwrap().state, JobState::Succeeded);
    let plan = |revision| store.solution(id, revision).unwrap().map(|found| found.revision);
    assert_eq!(plan(Revision::Best), Some(2));
    assert_eq!([1, 2, 3].map(|number| plan(Revision::Number(number))), [Some(1), Some(2), None]);
    assert_eq!(store.solution(id, Revision::Number(1)).unwrap().unwrap().metrics, metrics());
}

#[test]
fn nothing_follows_the_end_and_nothing_comes_out_of_turn() {
    let store = memory();
    let at = Timestamp::now();
    let (id, lease) = started(&store);
    let refused = |body| {
        let result = store.append(id, Some(lease), at, body);
        assert!(matches!(result, Err(StoreError::OutOfTurn { .. })), "{result:?}");
    };
    refused(EventBody::Started);
    refused(EventBody::Queued { position: 1 });
    let progress = Progress { elapsed_s: 1.0, phase: "search", iterations: 1, steps_lower_bound: None };
    refused(EventBody::Progress(progress));
    let late = Terminal { reason: TerminationReason::QueueTimeout, metrics: None, diagnosis: None };
    refused(EventBody::Terminal(late));
    refused(lost(3));
    store.append(id, Some(lease), at, incumbent(2, 1)).unwrap();
    refused(incumbent(2, 1));
    store.append(id, Some(lease), at, end()).unwrap();
    [end(), incumbent(3, 1), EventBody::Started, lost(2)].into_iter().for_each(refused);
    let stranger = JobId::fresh();
    assert_eq!(store.append(stranger, None, at, end()).unwrap_err(), StoreError::UnknownJob(stranger));
}

#[test]
fn a_later_attempt_fences_off_the_earlier() {
    let store = memory();
    let at = Timestamp::now();
    let (id, first) = started(&store);
    assert_eq!(store.lease(id, at, at), Err(StoreError::Leased(id)));
    assert!(store.abandoned(at).unwrap().is_empty());
    store.append(id, None, at, lost(2)).unwrap();
    let fenced = StoreError::Fenced { job: id, attempt: 1 };
    assert_eq!(store.append(id, Some(first), at, incumbent(1, 1)).unwrap_err(), fenced);
    assert_eq!(store.renew(first, at, at), Err(fenced.clone()));
    let second = store.lease(id, at, at).unwrap();
    assert_eq!(second.attempt, 2);
    store.append(id, Some(second), at, EventBody::Started).unwrap();
    assert_eq!(store.append(id, Some(first), at, end()).unwrap_err(), fenced);
    store.append(id, Some(second), at, incumbent(1, 1)).unwrap();
    store.renew(second, at, at).unwrap();
}

#[test]
fn the_file_remembers_and_leases_of_an_earlier_process_are_void() {
    let folder = tempfile::tempdir().unwrap();
    let open = || EmbeddedStore::open(folder.path(), Retention::default()).unwrap();
    let store = open();
    assert!(EmbeddedStore::open(folder.path(), Retention::default()).is_err(), "one process at a time");
    let request = JobRequest {
        problem: b"{\"a\": 1}"[..].into(),
        workcell: Some("sha256:1".to_owned()),
        warm_start: Some("{}".into()),
        labels: [("line".to_owned(), "7".to_owned())].into(),
        priority: -2,
        queue_ttl: Some(Duration::from_secs(5)),
        client: "a".to_owned(),
        idempotency: Some(Idempotency { key: "k".to_owned(), digest: "d".to_owned() }),
    };
    let waiting = store.create(new(request.clone())).unwrap().id;
    let (running, lease) = started(&store);
    store.append(running, Some(lease), Timestamp::now(), incumbent(1, 5)).unwrap();
    let alive = Timestamp::now().plus(Duration::from_secs(100));
    store.renew(lease, alive, alive).unwrap();
    let ended = started(&store);
    store.append(ended.0, Some(ended.1), Timestamp::now(), end()).unwrap();
    let before: Vec<JobRecord> = store.list(&all(10)).unwrap();
    drop(store);

    let store = open();
    assert_eq!(store.list(&all(10)).unwrap(), before);
    assert_eq!(store.request(waiting).unwrap(), request);
    assert_eq!(store.keyed("k").unwrap(), Some((waiting, "d".to_owned())));
    let abandoned = store.abandoned(Timestamp::now()).unwrap();
    assert_eq!(abandoned.iter().map(|(job, at)| (job.id, *at)).collect::<Vec<_>>(), [(running, alive)]);
    assert_eq!(store.waiting().unwrap().iter().map(|job| job.id).collect::<Vec<_>>(), [waiting]);
    assert_eq!(store.events_after(running, 0, 9).unwrap().len(), 3);
    let late = store.append(running, Some(lease), Timestamp::now(), end());
    assert_eq!(late.unwrap_err(), StoreError::Fenced { job: running, attempt: 1 });
    assert_eq!(&*store.solution(running, Revision::Best).unwrap().unwrap().document, "xxxxx");
}

/// The first bytes of a store that redb takes for one.
const MAGIC: &[u8] = b"redb";

#[test]
fn a_store_is_there_whole_or_not_at_all() {
    use std::sync::atomic::{AtomicBool, Ordering};

    for _ in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(file::FILE);
        let opened = AtomicBool::new(false);
        let seen = std::thread::scope(|scope| {
            let looking = scope.spawn(|| {
                let mut seen = Vec::new();
                // What a process that is killed at this instant would leave.
                while !opened.load(Ordering::Relaxed) {
                    seen.extend(std::fs::read(&path).ok().map(|bytes| bytes.get(..4).map(<[u8]>::to_vec)));
                }
                seen
            });
            let store = EmbeddedStore::open(folder.path(), Retention::default());
            opened.store(true, Ordering::Relaxed);
            drop(store.unwrap());
            looking.join().unwrap()
        });
        assert!(seen.iter().all(|first| first.as_deref() == Some(MAGIC)), "{seen:?}");
        assert_eq!(std::fs::read(&path).unwrap()[..4], *MAGIC);
    }
}

#[test]
fn what_a_killed_process_did_not_finish_is_cleared_away() {
    let folder = tempfile::tempdir().unwrap();
    let (part, other) =
        (folder.path().join("quadrille-x1.redb.new"), folder.path().join("quadrille-x1.redb"));
    std::fs::write(&part, [0; 4096]).unwrap();
    std::fs::write(&other, [0; 4096]).unwrap();
    let open = || EmbeddedStore::open(folder.path(), Retention::default());
    let job = created(&open().unwrap());
    assert!(!part.exists() && other.exists());
    std::fs::write(&part, [0; 4096]).unwrap();
    assert_eq!(open().unwrap().list(&all(9)).unwrap()[0].id, job);
    assert!(!part.exists() && other.exists());
}

#[test]
fn of_processes_that_begin_at_the_same_time_one_gets_the_store() {
    for _ in 0..10 {
        let folder = tempfile::tempdir().unwrap();
        let opened: Vec<Result<EmbeddedStore, StoreError>> = std::thread::scope(|scope| {
            let open = || EmbeddedStore::open(folder.path(), Retention::default());
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(open)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(opened.iter().filter(|store| store.is_ok()).count(), 1);
        for why in opened.iter().filter_map(|store| store.as_ref().err()) {
            assert!(why.to_string().contains("in use by another process"), "{why}");
        }
        let names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(names, [file::FILE]);
    }
}

#[test]
fn a_file_that_is_no_store_is_left_alone_and_the_error_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(file::FILE);
    let foreign = vec![7; 8192];
    std::fs::write(&path, &foreign).unwrap();
    let Err(why) = EmbeddedStore::open(folder.path(), Retention::default()) else { panic!("it opened") };
    assert!(why.to_string().contains("put the file elsewhere"), "{why}");
    assert_eq!(std::fs::read(&path).unwrap(), foreign);
}

#[test]
fn an_idempotency_key_belongs_to_one_job_for_as_long_as_that_is_kept() {
    let store = memory();
    let keyed = |digest: &str| {
        let idempotency = Some(Idempotency { key: "k".to_owned(), digest: digest.to_owned() });
        new(JobRequest { idempotency, ..JobRequest::default() })
    };
    let first = store.create(keyed("d")).unwrap().id;
    let taken = StoreError::KeyTaken { job: first, digest: "d".to_owned() };
    assert_eq!(store.create(keyed("other")).unwrap_err(), taken);
    assert_eq!(store.list(&all(10)).unwrap().len(), 1);
    assert_eq!(store.delete(first), Err(StoreError::NotEnded(first)));
    let cancelled = Terminal { reason: TerminationReason::ClientCancel, metrics: None, diagnosis: None };
    assert!(store.request(first).is_ok());
    store.append(first, None, Timestamp::now(), EventBody::Terminal(cancelled)).unwrap();
    assert_eq!(store.request(first), Err(StoreError::UnknownJob(first)), "nobody runs it again");
    assert_eq!(store.keyed("k").unwrap().unwrap().0, first);
    store.delete(first).unwrap();
    assert_eq!(store.delete(first), Err(StoreError::UnknownJob(first)));
    assert_eq!(store.keyed("k").unwrap(), None);
    store.create(keyed("other")).unwrap();
}

#[test]
fn ended_jobs_are_forgotten_oldest_first_and_open_ones_never() {
    let retention = Retention { jobs: 3, plan_bytes: 100, ..Retention::default() };
    let store = EmbeddedStore::in_memory(retention).unwrap();
    let (running, _) = started(&store);
    let mut at = Timestamp::now();
    let ended: Vec<JobId> = (0..5)
        .map(|_| {
            at = at.plus(Duration::from_secs(1));
            let (id, lease) = started(&store);
            store.append(id, Some(lease), at, incumbent(1, 40)).unwrap();
            store.append(id, Some(lease), at, end()).unwrap();
            id
        })
        .collect();
    // Three by number, two by bytes.
    let kept = || store.list(&all(10)).unwrap().iter().map(|record| record.id).collect::<Vec<_>>();
    assert_eq!(kept(), [ended[4], ended[3], running]);
    let older = ListQuery { before: Some(ended[3]), ..all(10) };
    assert_eq!(store.list(&older).unwrap().len(), 1);
    assert_eq!(store.events_after(ended[0], 0, 1).unwrap_err(), StoreError::UnknownJob(ended[0]));
    store.sweep(at.plus(Duration::from_secs(7 * 24 * 3600))).unwrap();
    assert_eq!(kept().len(), 2, "the one that is a second older is gone");
    store.sweep(at.plus(Duration::from_secs(30 * 24 * 3600))).unwrap();
    assert_eq!(kept(), [running]);
}

#[test]
fn old_events_are_trimmed_and_the_best_plan_never() {
    let retention = Retention { job_events: 10, job_plan_bytes: 100, ..Retention::default() };
    for (bytes, kept) in [(1, 10), (30, 3), (1000, 1)] {
        let store = EmbeddedStore::in_memory(retention).unwrap();
        let (id, lease) = started(&store);
        for revision in 1..=80 {
            store.append(id, Some(lease), Timestamp::now(), incumbent(revision, bytes)).unwrap();
        }
        store.append(id, Some(lease), Timestamp::now(), end()).unwrap();
        let events = store.events_after(id, 0, 1000).unwrap();
        assert_eq!(events.len(), kept + 1, "{bytes}");
        let record = store.record(id).unwrap();
        assert_eq!((record.trimmed + 1, record.last_seq), (events[0].seq, 83));
        assert_eq!(store.solution(id, Revision::Best).unwrap().unwrap().revision, 80);
        assert!(store.solution(id, Revision::Number(1)).unwrap().is_none());
    }
}

#[test]
fn lists_are_filtered_by_state_and_label() {
    let store = memory();
    let labelled = |value: &str| {
        let labels = [("line".to_owned(), value.to_owned())].into();
        store.create(new(JobRequest { labels, ..JobRequest::default() })).unwrap().id
    };
    let (seven, eight) = (labelled("7"), labelled("8"));
    let (running, _) = started(&store);
    let found = |states: &[JobState], labels: &[(&str, Option<&str>)]| {
        let labels =
            labels.iter().map(|(key, value)| ((*key).to_owned(), value.map(str::to_owned))).collect();
        let query = ListQuery { states: states.to_vec(), labels, ..all(10) };
        store.list(&query).unwrap().iter().map(|record| record.id).collect::<Vec<_>>()
    };
    assert_eq!(found(&[], &[]), [running, eight, seven]);
    assert_eq!(found(&[JobState::Running, JobState::Failed], &[]), [running]);
    assert_eq!(found(&[], &[("line", None)]), [eight, seven]);
    assert_eq!(found(&[JobState::Queued], &[("line", Some("7"))]), [seven]);
    assert!(found(&[JobState::Running], &[("line", None)]).is_empty());
}

#[test]
fn readers_of_large_plans_share_them_and_take_a_few_at_a_time() {
    let store = memory();
    let (id, lease) = started(&store);
    for revision in 1..=8 {
        store.append(id, Some(lease), Timestamp::now(), incumbent(revision, READ_BYTES / 2)).unwrap();
    }
    store.append(id, Some(lease), Timestamp::now(), end()).unwrap();
    let (mut held, mut reads) = (Vec::new(), 0);
    while held.last().is_none_or(|event: &Arc<Event>| event.seq < 11) {
        let after = held.last().map_or(0, |event| event.seq);
        let events = store.events_after(id, after, 100).unwrap();
        assert!(!events.is_empty());
        assert!(events.iter().map(|event| document_bytes(event)).sum::<usize>() <= 2 * READ_BYTES);
        held.extend(events);
        reads += 1;
    }
    assert_eq!(held.iter().map(|event| event.seq).collect::<Vec<_>>(), (1..=11).collect::<Vec<_>>());
    assert!(reads > 2, "{reads}");
    // Another reader gets what the first one holds.
    let again = store.events_after(id, 0, 100).unwrap();
    assert!(again.iter().zip(&held).all(|(one, other)| Arc::ptr_eq(one, other)));
}
