//! The engine: shows patterns, takes frames, keeps what must not be lost, and leaves merging to a worker.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use super::acquisition::{Accepted, Acquisition, Effort, Refused, Taken};
use super::journal::{FrameEntry, Journal, JournalEntry, Recorded};
use super::state::{Control, Input, State};
use super::worker::{LobeFrames, Pair, Work, Worker, channel};
use super::{Bench, CaptureError, Crop, Director, Exposer, ResponseImage, RunFolder, SensorMaps, Spent};
use crate::optics::Rig;
use crate::patterns::{Lobe, Pattern, RigTime, Sign, Timing};
use crate::store::StoreError;

/// Told of every frame: how many are done, how many there are (an estimate while exposures are chosen on the way).
pub type Progress<'a> = dyn FnMut(usize, usize) + 'a;

/// How often a paused run looks whether it may go on.
const PAUSE_POLL: Duration = Duration::from_millis(20);

/// What a run shows and keeps.
pub struct Run<'a> {
    /// The two frames of every step.
    pub patterns: &'a [Pattern],
    /// Whether steps are mixtures rather than functions: see [`Lobe::mixed`].
    pub mixed: bool,
    /// Says which steps are taken.
    pub director: &'a mut dyn Director,
    /// How often each of them is taken.
    pub repeats: usize,
    /// Chooses exposures.
    pub exposer: &'a mut dyn Exposer,
    /// The longest exposure there can be, s.
    pub longest_s: f64,
    /// The part of the sensor that is merged.
    pub crop: Crop,
    /// What is known of single pixels.
    pub maps: Option<&'a SensorMaps>,
    /// Where frames are journaled and responses stored as they come; what it holds already is not taken again.
    pub folder: Option<&'a RunFolder>,
    /// Makes the folder ready, once the devices are open.
    pub begin: &'a mut dyn FnMut() -> Result<(), StoreError>,
}

/// What a session of a run was like.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunSummary {
    /// What the engine cost.
    pub effort: Effort,
    /// Frames taken in all sessions.
    pub frames: usize,
    /// Patterns taken in all sessions.
    pub images: usize,
    /// Time that the frames of all sessions take on the physical rig.
    pub rig_time: RigTime,
    /// Time on the bench's clock from the first request to the last frame of this session, s, making ready left out.
    pub elapsed_s: f64,
    /// Time on the bench's clock for making ready, s.
    pub preparation_s: f64,
    /// Frames that were no good in all sessions.
    pub rejected: usize,
    /// From the projector's word to its light, s.
    pub latency_s: f64,
    /// Whether a coded patch proved every frame.
    pub tagged: bool,
    /// Least and greatest light of the lamp relative to the start of the run.
    pub light: [f64; 2],
    /// Standard error of the lamp's light, relative.
    pub light_sigma: f64,
}

/// Runs plans on a bench.
pub struct Engine<'a> {
    rig: &'a Rig,
    bench: &'a mut dyn Bench,
    control: Control,
    state: State,
}

impl<'a> Engine<'a> {
    /// An engine for the devices of a rig, steered by `control`.
    pub fn new(rig: &'a Rig, bench: &'a mut dyn Bench, control: Control) -> Self {
        Self { rig, bench, control, state: State::Idle }
    }

    /// Where it is.
    pub fn state(&self) -> State {
        self.state
    }

    /// Takes every frame of `run` and hands each lobe's HDR response, the mean over repeats, to `sink`, in the plan's order,
    /// while further frames are taken. With a folder, `sink` gets responses as stored.
    ///
    /// # Errors
    /// [`CaptureError`]; what was stored until then stays and need not be taken again.
    pub fn run(
        &mut self,
        mut run: Run<'_>,
        progress: &mut Progress<'_>,
        sink: impl FnMut(Lobe, ResponseImage) + Send,
    ) -> Result<RunSummary, CaptureError> {
        self.enter(Input::Begin);
        let checked = self.check(&mut run);
        let (mut devices, journal, recorded) = match checked {
            Ok(checked) => checked,
            Err(error) => {
                self.enter(Input::Fault);
                return Err(error);
            }
        };
        self.enter(Input::Checked);
        let mut session = Session {
            journal,
            recorded,
            light: [f64::INFINITY, f64::NEG_INFINITY],
            index: 0,
            images: 0,
            rig_time: RigTime::default(),
            decided_s: 0.0,
            elapsed_s: 0.0,
            preparation_s: 0.0,
        };
        let result = self.session(&mut run, &mut devices, &mut session, progress, sink);
        match &result {
            Ok(()) => self.enter(Input::Stored),
            Err(CaptureError::Stopped { .. }) => self.enter(Input::Abort),
            Err(_) => self.enter(Input::Fault),
        }
        if let (Err(error), Some(journal)) = (&result, &mut session.journal) {
            // The error itself is reported; on a full disk this line is lost too.
            let _ = journal.append(&JournalEntry::Stopped { reason: error.to_string() });
        }
        let restored = devices.restore();
        self.enter(if restored.is_ok() { Input::Restored } else { Input::Fault });
        result.and(restored)?;
        Ok(RunSummary {
            effort: devices.effort,
            frames: session.index,
            images: session.images,
            rig_time: session.rig_time,
            elapsed_s: session.elapsed_s,
            preparation_s: session.preparation_s,
            rejected: session.recorded.rejected + devices.effort.rejected,
            latency_s: devices.latency_s,
            tagged: devices.tag.is_some(),
            light: session.light,
            light_sigma: devices.lamp.sigma(),
        })
    }

    /// All that can be found out before anything moves; the folder begins when the devices are open.
    fn check(&mut self, run: &mut Run<'_>) -> Result<(Acquisition<'a>, Option<Journal>, Recorded), CaptureError> {
        let mut exposures = run.exposer.first();
        exposures.push(run.longest_s);
        let devices = Acquisition::open(self.rig, self.bench, &exposures)?;
        (run.begin)()?;
        let journal = run.folder.map(RunFolder::journal).transpose()?;
        let (journal, recorded) = journal.map_or((None, Recorded::default()), |(j, r)| (Some(j), r));
        self.bench.foresee(run.patterns);
        Ok((devices, journal, recorded))
    }

    fn session(
        &mut self,
        run: &mut Run<'_>,
        devices: &mut Acquisition<'_>,
        session: &mut Session,
        progress: &mut Progress<'_>,
        sink: impl FnMut(Lobe, ResponseImage) + Send,
    ) -> Result<(), CaptureError> {
        let recorded = &session.recorded;
        let opened_s = devices.clock.now_s();
        devices.prepare(run.patterns, run.longest_s, recorded.first_contrast, recorded.next_sequence())?;
        devices.recall_lamp(&recorded.in_order);
        let entry = JournalEntry::Prepared {
            latency_s: devices.latency_s,
            tag_level: devices.tag_level,
            tag_contrast: devices.tag.as_ref().map(super::TagModel::total),
        };
        session.journal.as_mut().map_or(Ok(()), |j| j.append(&entry))?;
        self.enter(Input::Prepared);
        let ready_s = devices.clock.now_s();
        session.preparation_s = ready_s - opened_s;
        let worker = Worker {
            sensor: devices.sensor,
            crop: run.crop,
            maps: run.maps,
            repeats: run.repeats,
            mixed: run.mixed,
            folder: run.folder,
            memory: vec![Vec::new(); run.patterns.len() / 2],
            sink,
        };
        let (sender, receiver) = channel();
        thread::scope(|scope| {
            let worker = scope.spawn(|| worker.run(receiver));
            let alive = || !worker.is_finished();
            let mut line = Line { progress, worker: sender, alive: &alive };
            let taken = self.batches(run, devices, session, &mut line);
            drop(line);
            session.elapsed_s = devices.clock.now_s() - ready_s;
            if session.recorded.in_order.is_empty() {
                // All of it was seen: what is neither exposure nor readout was spent on patterns that changed.
                let t = &mut session.rig_time;
                t.pattern_change_s = (session.elapsed_s - session.decided_s - t.exposure_s - t.readout_wait_s).max(0.0);
            }
            if taken.is_ok() {
                self.enter(Input::Exhausted);
            }
            let merged = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            // Where the worker failed, that is why frames could not be handed over.
            merged.and(taken)
        })
    }

    /// Takes what the director asks for until that is nothing.
    fn batches(
        &mut self,
        run: &mut Run<'_>,
        devices: &mut Acquisition<'_>,
        session: &mut Session,
        line: &mut Line<'_, '_>,
    ) -> Result<(), CaptureError> {
        let mut began = (Instant::now(), devices.clock.now_s());
        loop {
            let steps = run.director.next(&session.spent(began.0));
            if steps.is_empty() {
                return Ok(());
            }
            if session.images > 0 {
                session.rig_time.decision_s += began.0.elapsed().as_secs_f64();
                session.decided_s += devices.clock.now_s() - began.1;
            }
            self.steps(run, &steps, devices, session, line)?;
            began = (Instant::now(), devices.clock.now_s());
            if run.director.is_adaptive() {
                // What is decided next is decided from all frames so far.
                let (done, wait) = sync_channel(1);
                let stopped = |_| CaptureError::Stopped { done: session.index, total: session.index };
                line.worker.send(Work::Flush(done)).map_err(|_| stopped(()))?;
                wait.recv().map_err(|_| stopped(()))?;
            }
        }
    }

    /// Takes these steps, as often as the run says.
    fn steps(
        &mut self,
        run: &mut Run<'_>,
        steps: &[usize],
        devices: &mut Acquisition<'_>,
        session: &mut Session,
        line: &mut Line<'_, '_>,
    ) -> Result<(), CaptureError> {
        let Line { progress, worker, alive } = line;
        let total = run.repeats * run.director.expected() * run.exposer.expected_frames();
        let send = |pair| worker.send(Work::Pair(pair)).map_err(|_| CaptureError::Stopped { done: 0, total });
        let timing = Timing::of(self.rig);
        for repeat in 0..run.repeats {
            for (i, &k) in steps.iter().enumerate() {
                let lobes = Lobe::both(k, run.mixed);
                let stored =
                    run.folder.is_some_and(|folder| lobes.iter().all(|l| folder.response_path(l, repeat).is_file()));
                if let (true, Some(folder)) = (stored, run.folder) {
                    if run.exposer.is_adaptive() {
                        let read = |lobe| ResponseImage::read_of(&folder.response_path(lobe, repeat), run.crop);
                        let pair = [read(&lobes[0])?, read(&lobes[1])?];
                        run.exposer.further(k, pair.each_ref());
                    }
                    session.skip(repeat, &lobes, &timing);
                    progress(session.index, total.max(session.index));
                    send(Pair { k, repeat, lobes: [LobeFrames::Stored, LobeFrames::Stored] })?;
                    continue;
                }
                let again = if repeat + 1 < run.repeats { steps.first() } else { None };
                let after = steps.get(i + 1).or(again).map(|next| 2 * next);
                let mut frames: [Vec<(usize, Taken)>; 2] = [Vec::new(), Vec::new()];
                let first = run.exposer.first();
                let adaptive = run.exposer.is_adaptive();
                let mut stages = vec![(0, first.clone(), Some(2 * k + 1)), (1, first, after.filter(|_| !adaptive))];
                let mut stage = 0;
                while stage < stages.len() {
                    let (i, exposures, next) = stages[stage].clone();
                    let lobe = lobes[i];
                    let before = frames[i].len();
                    let mut step = StepFrames { engine: self, session, run, progress, alive, total };
                    frames[i].extend(step.lobe(devices, repeat, lobe, before, &exposures, next)?);
                    stage += 1;
                    if stage == 2 && adaptive {
                        let merged = frames.each_ref().map(|frames| {
                            let taken: Vec<Taken> = frames.iter().map(|(_, taken)| taken.clone()).collect();
                            // As a resumed run would read it.
                            ResponseImage::merge(&devices.sensor, run.maps, run.crop, &taken).as_stored()
                        });
                        let more = run.exposer.further(k, merged.each_ref());
                        if !more.is_empty() {
                            stages.push((1, more.clone(), Some(2 * k)));
                            stages.push((0, more, after));
                        }
                    }
                }
                for frames in &frames {
                    let exposures: Vec<f64> = frames.iter().map(|(_, taken)| taken.exposure_s).collect();
                    session.shown(&exposures, &timing);
                }
                send(Pair { k, repeat, lobes: frames.map(LobeFrames::Taken) })?;
            }
        }
        Ok(())
    }

    fn enter(&mut self, input: Input) {
        self.state = self.state.after(input).unwrap_or_else(|| panic!("{input:?} cannot happen while {}", self.state));
    }
}

/// Who is told of what is taken.
struct Line<'l, 'p> {
    progress: &'l mut Progress<'p>,
    worker: SyncSender<Work>,
    /// Whether the worker still works.
    alive: &'l dyn Fn() -> bool,
}

/// One session's share of a run.
struct Session {
    journal: Option<Journal>,
    recorded: Recorded,
    light: [f64; 2],
    /// Frames done, and the position of the next.
    index: usize,
    images: usize,
    rig_time: RigTime,
    /// Time of decisions on the bench's clock, s: a simulated one may stand still meanwhile.
    decided_s: f64,
    elapsed_s: f64,
    preparation_s: f64,
}

impl Session {
    fn seen(&mut self, light: f64) {
        self.light = [self.light[0].min(light), self.light[1].max(light)];
    }

    /// Counts a pattern under its exposures.
    fn shown(&mut self, exposures_s: &[f64], timing: &Timing) {
        self.images += 1;
        self.rig_time = self.rig_time.and(RigTime::of_pattern(exposures_s, timing));
    }

    /// For a decision that the rig has been waiting for since `began`.
    fn spent(&self, began: Instant) -> Spent {
        let frames_s = RigTime { decision_s: 0.0, ..self.rig_time }.total_s();
        if self.index < self.recorded.in_order.len() {
            return Spent::frames(frames_s);
        }
        Spent::waiting(frames_s, self.rig_time.decision_s, began)
    }

    /// Counts the frames of a pair that an earlier session took.
    fn skip(&mut self, repeat: usize, lobes: &[Lobe; 2], timing: &Timing) {
        for lobe in lobes {
            let mut exposures = Vec::new();
            for exposure in 0.. {
                let Some(frame) = self.recorded.frame(repeat, *lobe, exposure) else { break };
                let light = frame.light;
                exposures.push(frame.exposure_s);
                self.seen(light);
                self.index += 1;
            }
            self.shown(&exposures, timing);
        }
    }
}

/// What taking the frames of a step needs.
struct StepFrames<'s, 'a, 'r, 'p> {
    engine: &'s mut Engine<'a>,
    session: &'s mut Session,
    run: &'s Run<'r>,
    progress: &'s mut Progress<'p>,
    alive: &'s dyn Fn() -> bool,
    total: usize,
}

impl StepFrames<'_, '_, '_, '_> {
    /// Frames of a lobe with these exposures, the first of which is its exposure number `number`; those an earlier session
    /// took are read, the others taken.
    fn lobe(
        &mut self,
        devices: &mut Acquisition<'_>,
        repeat: usize,
        lobe: Lobe,
        number: usize,
        exposures: &[f64],
        next: Option<usize>,
    ) -> Result<Vec<(usize, Taken)>, CaptureError> {
        let mut frames: Vec<Option<(usize, Taken)>> = vec![None; exposures.len()];
        let first = self.session.index;
        if let Some(folder) = self.run.folder {
            for (j, slot) in frames.iter_mut().enumerate() {
                if let Some(entry) = self.session.recorded.frame(repeat, lobe, number + j).copied() {
                    *slot = Some((first + j, folder.pending(&entry, self.run.crop)?));
                    self.session.seen(entry.light);
                }
            }
        }
        let missing: Vec<usize> = (0..exposures.len()).filter(|&j| frames[j].is_none()).collect();
        let wanted: Vec<f64> = missing.iter().map(|&j| exposures[j]).collect();
        self.session.index += exposures.len() - missing.len();
        let shown = 2 * lobe.k + usize::from(lobe.sign == Sign::Negative);
        let mut at = missing.first().copied().unwrap_or(0);
        let result = if wanted.is_empty() {
            Ok(())
        } else {
            devices.take(shown, &wanted, next, &mut |i, frame| {
                at = missing[i];
                let index = first + at;
                match frame {
                    Ok(accepted) => {
                        frames[at] = Some((index, self.keep(index, repeat, lobe, number + at, accepted)?));
                    }
                    Err(refused) => self.note(index, lobe, wanted[i], refused)?,
                }
                self.steered()
            })
        };
        result.map_err(|source| match source {
            CaptureError::Stopped { .. } => CaptureError::Stopped { done: self.session.index, total: self.total },
            source => CaptureError::At {
                index: first + at,
                lobe: lobe.stem(),
                exposure_ms: 1e3 * exposures[at],
                source: Box::new(source),
            },
        })?;
        Ok(frames.into_iter().map(|f| f.expect("taken, or the loop would not have ended")).collect())
    }

    fn keep(
        &mut self,
        index: usize,
        repeat: usize,
        lobe: Lobe,
        exposure: usize,
        accepted: Accepted,
    ) -> Result<Taken, CaptureError> {
        let Accepted { frame, light, reading } = accepted;
        let crop = self.run.crop;
        let samples = Acquisition::cut(&frame, crop);
        if let (Some(folder), Some(journal)) = (self.run.folder, &mut self.session.journal) {
            let entry = FrameEntry {
                index,
                repeat,
                lobe,
                exposure,
                exposure_s: frame.exposure_s,
                gain: frame.gain,
                sequence: frame.sequence,
                timestamp_s: frame.timestamp_s,
                light,
                light_reading: reading,
            };
            folder.keep_pending(&entry, crop, &samples)?;
            journal.append(&JournalEntry::Frame(entry))?;
        }
        self.session.seen(light);
        self.session.index += 1;
        (self.progress)(self.session.index, self.total.max(self.session.index));
        let exposure_s = frame.exposure_s;
        let whole = self.run.folder.is_some_and(RunFolder::keeps_frames).then(|| Arc::new(frame));
        Ok(Taken { samples, exposure_s, light, frame: whole })
    }

    fn note(&mut self, index: usize, lobe: Lobe, exposure_s: f64, refused: Refused) -> Result<(), CaptureError> {
        let Refused { reason, sequence } = refused;
        let entry = JournalEntry::Rejected { index, lobe, exposure_s, sequence, reason: reason.to_string() };
        Ok(self.session.journal.as_mut().map_or(Ok(()), |j| j.append(&entry))?)
    }

    /// Does what was asked from outside, between two frames.
    fn steered(&mut self) -> Result<(), CaptureError> {
        let stopped = CaptureError::Stopped { done: self.session.index, total: self.total };
        let control = self.engine.control.clone();
        if control.paused() {
            self.engine.enter(Input::Pause);
            self.session.journal.as_mut().map_or(Ok(()), |j| j.append(&JournalEntry::Paused))?;
            while control.paused() && (self.alive)() {
                thread::sleep(PAUSE_POLL);
            }
            if !control.aborted() {
                self.session.journal.as_mut().map_or(Ok(()), |j| j.append(&JournalEntry::Resumed))?;
                self.engine.enter(Input::Resume);
            }
        }
        if control.aborted() || !(self.alive)() { Err(stopped) } else { Ok(()) }
    }
}
