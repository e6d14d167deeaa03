//! From a problem to judged incumbents.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use crate::collision::CollisionWorld;
use crate::guidance::{Answer, Certificate, Cuts, Effort, Instance, Network, Proof, solve};
use crate::mode_graph::{ModeGraph, ModeGraphOptions, build_mode_graph, optimistic_mode_graph};
use crate::motion::Roadmap;
use crate::plan::{Metrics, Plan, StepsProof};
use crate::problem::{Objective, Problem};
use crate::run::{CancelToken, Control, Deadline, Seed};
use crate::search::{Candidate, Map, Report, Search, Settings};
use crate::transition::{Contacts, SampledReach};
use crate::verify::verify_unless;

use super::cache::PlannerCache;
use super::event::{Outcome, PlannerEvent, Termination};

/// Pairs of actions that are looked at closely and found not to go together in one step before the search begins.
const MOST_CROWDINGS: usize = 6;

/// Further threads begin once there is a plan, or after they have waited this long for one. Before that they would do
/// what the first one does, and slow it down: processors share their memory, and often more.
const ALONE: Duration = Duration::from_millis(200);

/// The proof of how few steps any plan needs gets at least this time, although the run's ends.
const LEAST_PROOF: Duration = Duration::from_millis(100);

/// Least time (s) between two signs of life.
const PROGRESS_PERIOD_S: f64 = 0.25;

/// Plans for `problem` until it is solved as asked or `control` says stop, reporting to `observe`.
///
/// Every incumbent is strictly better than the one before and has passed [`crate::verify`].
/// With `options.threads` above 1, `observe` is called from several threads, one at a time.
pub fn plan(
    problem: &Problem,
    control: &Control,
    observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
) -> Outcome {
    plan_with(&PlannerCache::new(0), problem, control, observe)
}

/// [`plan`] with what `cache` knows of the workcell, and leaving there what was compiled of it. The
/// plans are the same whatever it knows; they are only sooner there.
pub fn plan_with(
    cache: &PlannerCache,
    problem: &Problem,
    control: &Control,
    observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
) -> Outcome {
    run(cache, problem, None, control, observe)
}

/// [`plan_with`] from a plan in hand, which the judge has accepted for this problem: only what is
/// better becomes an incumbent, and the search begins from it. A plan that is not made of steps as the
/// planner makes them (all arms at rest at their ends) is a bound alone.
pub fn improve_with(
    cache: &PlannerCache,
    problem: &Problem,
    known: &Plan,
    control: &Control,
    observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
) -> Outcome {
    run(cache, problem, Some(known), control, observe)
}

fn run(
    cache: &PlannerCache,
    problem: &Problem,
    known: Option<&Plan>,
    control: &Control,
    observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
) -> Outcome {
    let seed = Seed(problem.options.seed);
    let progress = |observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send), phase| {
        let elapsed_s = control.deadline.elapsed_s();
        observe(PlannerEvent::Progress { elapsed_s, phase, iterations: 0, steps_lower_bound: None });
    };
    progress(observe, "workcell");
    let compiled = cache.get(problem, control);
    let world = compiled.world(problem);
    progress(observe, "mode_graph");
    let mut reach = SampledReach::remembering(problem, &world, seed, compiled.memory());
    let graph = build_mode_graph(problem, &mut reach, &ModeGraphOptions::planning(), control);
    progress(observe, "guidance");
    let map = match Map::new(graph) {
        Ok(map) => map,
        Err(error) => {
            return failed(Termination::NoSolutionFound, format!("the mode graph makes no sense: {error}"));
        }
    };
    let others: [OnceLock<Map>; MOST_CROWDINGS] = Default::default();
    let (settings, roadmaps) = (Settings::default(), compiled.roadmaps().to_vec());
    let mut search =
        Search::new(problem, &world, &map, reach.into_contacts(), roadmaps, settings, seed, control);
    // Where the guidance knows a way there is one, and the proof of how few steps it takes can wait for a candidate.
    let bound = OnceLock::new();
    if !search.knows_a_way() {
        let proved = lower_bound(problem, seed, control);
        if proved.infeasible {
            let why = "no sequence of picks, places and handoffs leads to the goals, even if the arms \
                       reached everything within their greatest reach";
            return failed(Termination::Infeasible, why.to_owned());
        }
        bound.get_or_init(|| proved.steps);
    }
    // A plan in hand may do at once what is found here not to go together.
    if known.is_none() {
        search = settle(search, &others, false, control);
    }
    let run = Run {
        problem,
        world: &world,
        roadmaps: compiled.roadmaps(),
        handed: Mutex::new((problem.options.threads > 1).then(|| search.contacts().clone())),
        joined: AtomicUsize::new(0),
        map: Mutex::new(search.map()),
        others: &others,
        settles: AtomicBool::new(false),
        control,
        known,
        bound,
        seed,
        stop: CancelToken::new(),
        iterations: AtomicU64::new(0),
        under_way: Mutex::new(known.is_some()),
        joining: Condvar::new(),
        board: Mutex::new(Board {
            observe,
            best: known.cloned(),
            cost: known.map(|plan| plan.metrics.cost(problem.options.objective)),
            termination: None,
            cause: None,
            last_progress: f64::NEG_INFINITY,
            last_improvement: control.deadline.elapsed_s(),
            rejected: 0,
        }),
    };
    if let Some(Metrics { duration_s, steps, .. }) = known.map(|plan| &plan.metrics) {
        run.lock(|board| run.check_goals(board, *duration_s, *steps));
    }
    run.search_with(problem.options.threads.max(1), search);
    let outcome = run.outcome();
    cache.keep(problem, &compiled);
    outcome
}

/// `search`, or one like it on a mode graph to which it was added what cannot be done at once on the way that it
/// sets out on, or with the fewest steps if it `is_thorough`; unless that leaves no way. The maps are kept in `maps`.
fn settle<'a>(
    mut search: Search<'a>,
    maps: &'a [OnceLock<Map>],
    is_thorough: bool,
    control: &Control,
) -> Search<'a> {
    loop {
        if is_thorough && search.looks_for_crowding() {
            search.examine(control);
        }
        let Some(map) = crowded_map(&mut search, maps, control) else { return search };
        let next = search.anew_on(map, control);
        if !next.knows_a_way() {
            return search;
        }
        search = next;
    }
}

/// The map of `search`, in a free place of `maps`, with what was found not to go together on its way.
fn crowded_map<'a>(search: &mut Search<'a>, maps: &'a [OnceLock<Map>], control: &Control) -> Option<&'a Map> {
    let place = maps.iter().find(|place| place.get().is_none())?;
    let crowding = search.crowding(control)?;
    tracing::debug!(?crowding, "two ends of carries leave each other no room");
    let mut graph = search.map().graph().clone();
    graph.crowdings.push(crowding);
    let map = Map::new(graph).ok()?;
    Some(place.get_or_init(|| map))
}

/// The mode graph on which a run with this `seed` comes to search, made of the `graph` that was built with `reach`: with
/// what cannot be done at once on the ways with the fewest steps.
pub fn settled_mode_graph<'a>(
    problem: &'a Problem,
    world: &'a CollisionWorld,
    graph: ModeGraph,
    reach: SampledReach<'a>,
    seed: Seed,
    control: &Control,
) -> ModeGraph {
    let Ok(map) = Map::new(graph.clone()) else { return graph };
    let others: [OnceLock<Map>; MOST_CROWDINGS] = Default::default();
    // What is asked here takes no motions.
    let (contacts, settings) = (reach.into_contacts(), Settings::default());
    let search = Search::new(problem, world, &map, contacts, Vec::new(), settings, seed, control);
    let search = settle(search, &others, true, control);
    search.map().graph().clone()
}

/// What the optimistic graph proves about every synchronised plan.
fn lower_bound(problem: &Problem, seed: Seed, control: &Control) -> Bound {
    let unknown = Bound { steps: 0, infeasible: false };
    let Ok(network) = Network::new(Instance::from(&optimistic_mode_graph(problem))) else { return unknown };
    let start = network.instance().start();
    match solve(&network, &start, &Cuts::none(), &Effort::quick(), seed, control) {
        Ok(Answer::Solved(_, certificate)) => Bound { steps: certificate.lower_bound, infeasible: false },
        Ok(Answer::Infeasible(_)) => Bound { steps: 0, infeasible: true },
        Ok(Answer::Unknown { lower_bound }) => Bound { steps: lower_bound, infeasible: false },
        Err(_) => unknown,
    }
}

/// A run that ends before the search begins.
fn failed(termination: Termination, diagnosis: String) -> Outcome {
    Outcome { termination, best: None, diagnosis: Some(diagnosis) }
}

/// What the optimistic graph proves.
struct Bound {
    steps: usize,
    infeasible: bool,
}

/// What the threads share.
struct Run<'a, 'o> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    roadmaps: &'a [Roadmap],
    /// What threads that join begin to know of contacts.
    handed: Mutex<Option<Contacts<'a>>>,
    /// How many have joined.
    joined: AtomicUsize,
    /// What threads that join search on.
    map: Mutex<&'a Map>,
    /// Places for further maps, and whether a thread has set about filling them.
    others: &'a [OnceLock<Map>],
    settles: AtomicBool,
    control: &'a Control,
    /// A plan to begin from.
    known: Option<&'a Plan>,
    /// What the optimistic graph proves of every synchronised plan, once that was asked for.
    bound: OnceLock<usize>,
    seed: Seed,
    /// Raised when one thread has met a stop condition.
    stop: CancelToken,
    iterations: AtomicU64,
    /// Whether there is a plan to go on from, or nothing to be done any more.
    under_way: Mutex<bool>,
    /// Tells of `under_way`.
    joining: Condvar,
    board: Mutex<Board<'o>>,
}

/// The incumbent and the way to tell of it.
struct Board<'o> {
    observe: &'o mut (dyn FnMut(PlannerEvent<'_>) + Send),
    best: Option<Plan>,
    cost: Option<[f64; 2]>,
    termination: Option<Termination>,
    cause: Option<String>,
    last_progress: f64,
    last_improvement: f64,
    rejected: u64,
}

/// The end of a thread's search, however it comes: nobody waits for a plan any more, and where it is a panic, all end.
struct End<'r, 'a, 'o>(&'r Run<'a, 'o>);

impl Drop for End<'_, '_, '_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.stop.cancel();
        }
        self.0.let_others_join();
    }
}

impl<'a> Run<'a, '_> {
    fn search_with(&self, threads: usize, first: Search<'a>) {
        std::thread::scope(|scope| {
            for index in 1..threads {
                scope.spawn(move || {
                    let _end = End(self);
                    if index == 1 && !self.should_stop() {
                        // By the time that there is a candidate, it is known how many steps it takes at least.
                        self.bound();
                    }
                    self.wait_to_join();
                    if self.should_stop() {
                        return;
                    }
                    self.joined.fetch_add(1, Ordering::Relaxed);
                    let (problem, world) = (self.problem, self.world);
                    let own = self.seed.part(index as u64);
                    let handed = self.handed.lock().unwrap_or_else(PoisonError::into_inner).clone();
                    let Some(contacts) = handed else { return };
                    let contacts = contacts.with_rng(own.stream("contacts"));
                    let (settings, roadmaps) = (Settings::default(), self.roadmaps.to_vec());
                    let map = self.map();
                    let search =
                        Search::new(problem, world, map, contacts, roadmaps, settings, own, self.control);
                    self.search(search);
                });
            }
            let _end = End(self);
            self.search(first);
        });
    }

    /// `search`, which has just come to the first plan, or one like it that goes on from there: where the mode graph
    /// promises fewer steps than the plan has, and on the way that it promises something cannot be done at once, on a graph
    /// that knows so.
    fn settle_for_less(&self, mut search: Search<'a>) -> Search<'a> {
        let Some(plan) = self.lock(|board| board.best.clone()) else { return search };
        while !self.should_stop() && search.looks_for_crowding() {
            search.examine(self.control);
            if !search.wants_fewer_steps() {
                break;
            }
            let Some(map) = crowded_map(&mut search, self.others, self.control) else { break };
            let mut next = search.anew_on(map, self.control);
            if !next.knows_a_way() || next.resume(&plan, self.control).is_err() {
                break;
            }
            next.examine(self.control);
            // What was done once can be done.
            if next.certificate().is_none_or(|proved| proved.lower_bound > plan.metrics.steps) {
                break;
            }
            search = next;
            *self.map.lock().unwrap_or_else(PoisonError::into_inner) = map;
        }
        // The time that this took is none in which the plan did not improve.
        self.lock(|board| board.last_improvement = self.control.deadline.elapsed_s());
        search
    }

    fn map(&self) -> &'a Map {
        *self.map.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether `search` is on the map that the others are on, or will be.
    fn is_up_to_date(&self, search: &Search<'a>) -> bool {
        std::ptr::eq(self.map(), search.map())
    }

    /// Waits until there is a plan, or for [`ALONE`].
    fn wait_to_join(&self) {
        let begun = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        drop(self.joining.wait_timeout_while(begun, ALONE, |under_way| !*under_way));
    }

    fn others_may_join(&self) -> bool {
        *self.under_way.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hands what `search` knows of contacts to threads that join from now on.
    fn hand_over(&self, search: &Search<'a>) {
        let mut handed = self.handed.lock().unwrap_or_else(PoisonError::into_inner);
        if handed.is_some() && !self.should_stop() {
            *handed = Some(search.contacts().clone());
        }
    }

    fn let_others_join(&self) {
        *self.under_way.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.joining.notify_all();
    }

    /// One thread's search until a stop condition is met.
    fn search(&self, mut search: Search<'a>) {
        self.sign_of_life();
        let mut own = self.known.map(|plan| plan.metrics.cost(self.problem.options.objective));
        if let (Some(known), Some(cost)) = (self.known, own)
            && let Err(why) = search.resume(known, self.control)
        {
            tracing::info!(%why, "the plan to begin from is a bound alone");
            search.set_incumbent(cost);
        }
        while !self.should_stop() {
            if !self.is_up_to_date(&search) {
                search = search.anew_on(self.map(), self.control);
                own = None;
            }
            // What another thread has found goes on here, too.
            let others = self.lock(|board| match board.cost {
                Some(cost) if own != Some(cost) => {
                    own = Some(cost);
                    board.best.clone().map(|plan| (plan, cost))
                }
                _ => None,
            });
            if let Some((plan, cost)) = others
                && let Err(why) = search.resume(&plan, self.control)
            {
                tracing::debug!(%why, "the plan of another thread is a bound alone");
                search.set_incumbent(cost);
            }
            match search.iterate(self.control) {
                Report::Candidate(candidate) => {
                    // What was proved of an older graph is not proved of this one.
                    let certificate = search.certificate().filter(|_| self.is_up_to_date(&search)).cloned();
                    if let Some(cost) = self.judge(&candidate, certificate.as_ref(), search.timing_s()) {
                        search.accept(cost);
                        own = Some(cost);
                        if !self.others_may_join() && !self.settles.swap(true, Ordering::Relaxed) {
                            search = self.settle_for_less(search);
                            self.hand_over(&search);
                        }
                        self.let_others_join();
                    }
                }
                Report::Solved(candidate) => {
                    self.judge(&candidate, search.certificate(), search.timing_s());
                    self.lock(|board| self.end(board, Termination::NoImprovement));
                }
                Report::Nothing => {}
            }
            self.after_iteration(&search);
        }
        self.lock(|board| board.cause = board.cause.take().or_else(|| search.cause().map(str::to_owned)));
    }

    /// No plan has fewer steps. The first to ask waits for it.
    fn bound(&self) -> usize {
        *self.bound.get_or_init(|| {
            let left = self.control.deadline.remaining();
            let deadline = left.map_or_else(Deadline::never, |left| Deadline::after(left.max(LEAST_PROOF)));
            let control = Control { deadline, ..self.control.clone() };
            lower_bound(self.problem, self.seed, &control).steps
        })
    }

    fn lock<T>(&self, act: impl FnOnce(&mut Board<'_>) -> T) -> T {
        let mut board = self.board.lock().unwrap_or_else(PoisonError::into_inner);
        act(&mut board)
    }

    fn should_stop(&self) -> bool {
        let spent = self.problem.options.max_iterations;
        self.control.should_stop()
            || self.stop.is_cancelled()
            || spent.is_some_and(|most| self.iterations.load(Ordering::Relaxed) >= most)
    }

    fn end(&self, board: &mut Board<'_>, termination: Termination) {
        board.termination.get_or_insert(termination);
        self.stop.cancel();
    }

    /// Reports progress, unless that was done a moment ago.
    fn sign_of_life(&self) {
        let iterations = self.iterations.load(Ordering::Relaxed);
        let elapsed_s = self.control.deadline.elapsed_s();
        let last = self.lock(|board| {
            let last = board.last_progress;
            let is_due = elapsed_s - last >= PROGRESS_PERIOD_S;
            board.last_progress = if is_due { elapsed_s } else { last };
            is_due.then_some(last)
        });
        let Some(last) = last else { return };
        // The first candidate does not wait for the proof, nor do the others for who works it out.
        let is_first = last == f64::NEG_INFINITY;
        let steps_lower_bound = if is_first { self.bound.get().copied() } else { Some(self.bound()) };
        self.lock(|board| {
            let phase = if board.best.is_some() { "improve" } else { "search" };
            (board.observe)(PlannerEvent::Progress { elapsed_s, phase, iterations, steps_lower_bound });
        });
    }

    fn after_iteration(&self, search: &Search<'_>) {
        self.iterations.fetch_add(1, Ordering::Relaxed);
        self.sign_of_life();
        let elapsed_s = self.control.deadline.elapsed_s();
        self.lock(|board| {
            let patience = self.problem.options.stop.no_improvement_s;
            if board.best.is_some() && patience.is_some_and(|s| elapsed_s - board.last_improvement >= s) {
                self.end(board, Termination::NoImprovement);
            }
            if let Some(cause) = search.cause() {
                board.cause = Some(cause.to_owned());
            }
        });
    }

    /// Builds the plan, has it judged, and publishes it if it is better than what is known; its
    /// cost when it was published. It had been `timing_s` on the timing of paths.
    fn judge(
        &self,
        candidate: &Candidate,
        certificate: Option<&Certificate>,
        timing_s: f64,
    ) -> Option<[f64; 2]> {
        let options = &self.problem.options;
        let cost = candidate.cost(options.objective);
        if self.lock(|board| board.cost).is_some_and(|best| cost >= best) {
            return None;
        }
        let candidate_s = self.control.deadline.elapsed_s();
        let mut plan = self.assemble(candidate, certificate);
        let handed_in_s = self.control.deadline.elapsed_s();
        // The first plan is judged to the end, even when its time has come.
        let is_first = self.lock(|board| board.best.is_none());
        let is_over = || self.control.cancel.is_cancelled() || !is_first && self.control.deadline.passed();
        // The others may be waiting for the first plan.
        let alone = is_first && self.joined.load(Ordering::Relaxed) == 0;
        let threads = if alone { self.problem.options.threads } else { 1 };
        let verdict = verify_unless(self.problem, &plan, threads, &is_over)?;
        let judged_s = self.control.deadline.elapsed_s();
        let valid = verdict.valid;
        self.lock(|board| {
            (board.observe)(PlannerEvent::Judged { candidate_s, handed_in_s, timing_s, judged_s, valid })
        });
        if !verdict.valid {
            self.lock(|board| {
                board.rejected += 1;
                let why = verdict.first.as_ref().map_or_else(String::new, |v| v.message.clone());
                tracing::warn!(rejected = board.rejected, %why, "the judge rejected a candidate");
                board.cause = Some(format!("the judge rejected what was found: {why}"));
            });
            return None;
        }
        plan.verification = Some(verdict.verification());
        self.lock(|board| {
            // Another thread may have been faster.
            if board.cost.is_some_and(|best| cost >= best) {
                return None;
            }
            let found_after_s = self.control.deadline.elapsed_s();
            plan.metrics.found_after_s = found_after_s;
            plan.revision = board.best.as_ref().map_or(1, |best| best.revision + 1);
            board.cost = Some(cost);
            board.last_improvement = found_after_s;
            (board.observe)(PlannerEvent::Incumbent(&plan));
            board.best = Some(plan);
            self.check_goals(board, candidate.duration, candidate.steps);
            Some(cost)
        })
    }

    fn check_goals(&self, board: &mut Board<'_>, duration: f64, steps: usize) {
        let options = &self.problem.options;
        if options.stop.first_solution {
            self.end(board, Termination::FirstSolution);
        } else if options.stop.target_duration_s.is_some_and(|target| duration <= target) {
            self.end(board, Termination::TargetReached);
        } else if options.objective == Objective::Steps && steps <= self.bound() {
            // Fewer steps are impossible; a shorter duration at the same steps still counts, but
            // the objective itself is at its least.
            self.end(board, Termination::Optimal);
        }
    }

    fn assemble(&self, candidate: &Candidate, certificate: Option<&Certificate>) -> Plan {
        let optimum = certificate.and_then(|certificate| certificate.optimum);
        let proof = match certificate.map(|certificate| certificate.proof) {
            Some(Proof::Bounds) => StepsProof::Bounds,
            Some(Proof::Ilp) => StepsProof::Ilp,
            _ => StepsProof::None,
        };
        Plan {
            problem_digest: self.problem.digest.clone(),
            revision: 0,
            metrics: Metrics {
                duration_s: candidate.duration,
                duration_synchronous_s: candidate.duration,
                arc_length: candidate.arc_length,
                actions: candidate.actions.len(),
                steps: candidate.steps,
                mode_graph_optimum: optimum,
                steps_lower_bound: self.bound(),
                steps_proof: proof,
                found_after_s: 0.0,
            },
            arms: candidate.trajectories(),
            actions: candidate.actions.clone(),
            verification: None,
        }
    }

    fn outcome(self) -> Outcome {
        let cancelled = self.control.cancel.is_cancelled();
        let board = self.board.into_inner().unwrap_or_else(PoisonError::into_inner);
        let termination = match (board.termination, &board.best) {
            (Some(termination), Some(_)) => termination,
            _ if cancelled => Termination::Cancelled,
            (_, Some(_)) => Termination::TimeLimit,
            (_, None) => Termination::NoSolutionFound,
        };
        let diagnosis = match board.best {
            Some(_) => None,
            None => {
                Some(board.cause.unwrap_or_else(|| "the budget ended before the search began".to_owned()))
            }
        };
        Outcome { termination, best: board.best, diagnosis }
    }
}
