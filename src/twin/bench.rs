//! The simulated devices behind the traits of real ones.

use std::sync::{Arc, Mutex, PoisonError};

use super::clock::{RealClock, VirtualClock};
use super::devices::{Devices, Truth, TwinCameraFactory, TwinProjectorFactory, World};
use super::forward::Accuracy;
use super::scene::Scene;
use super::{Faults, TwinConfig};
use crate::capture::{Bench, CameraFactory, CaptureError, Clock, Placement, ProjectorFactory, Triggering};
use crate::optics::Rig;
use crate::patterns::Pattern;
use crate::reflectance::Brdf;

/// A simulated rig with a sample in it.
pub struct TwinBench {
    world: Arc<World>,
    camera: TwinCameraFactory,
    projector: TwinProjectorFactory,
}

impl TwinBench {
    /// A simulated rig that holds `sample`, with a triggered camera and time as fast as it can be computed.
    pub fn new(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>) -> Self {
        Self::with_accuracy(rig, config, sample, Accuracy::default())
    }

    /// The same with another quadrature.
    pub fn with_accuracy(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>, accuracy: Accuracy) -> Self {
        let scene = Scene::new(rig, config, sample, accuracy);
        Self::in_world(World {
            state: Mutex::new(Devices::new(1.0 / rig.projector.refresh_hz)),
            scene: Mutex::new(scene),
            clock: Arc::new(VirtualClock::default()),
            faults: Faults::default(),
            triggering: Triggering::Triggered,
        })
    }

    /// The same rig with another material on its gray card.
    pub fn with_card(self, card: Arc<dyn Brdf>) -> Self {
        self.changed(|world| world.scene.get_mut().unwrap_or_else(PoisonError::into_inner).card = card)
    }

    /// Sensor pixels of this rig that are hot, row by row: for tests.
    pub fn hot_pixels(&self) -> Vec<bool> {
        let scene = self.world.scene.lock().unwrap_or_else(PoisonError::into_inner);
        scene.sensor.hot_pixels()
    }

    fn in_world(world: World) -> Self {
        let world = Arc::new(world);
        Self { camera: TwinCameraFactory(world.clone()), projector: TwinProjectorFactory(world.clone()), world }
    }

    /// Changes what the devices share, before they are opened.
    fn changed(self, change: impl FnOnce(&mut World)) -> Self {
        let Self { world, camera, projector } = self;
        drop((camera, projector));
        let mut world = Arc::into_inner(world).expect("no device is open yet");
        change(&mut world);
        Self::in_world(world)
    }

    /// The same rig in real time.
    pub fn paced(self) -> Self {
        self.changed(|world| {
            let refresh_s = 1.0 / world.scene.get_mut().unwrap_or_else(PoisonError::into_inner).refresh_hz();
            // What the devices remember are times of the other clock.
            (world.clock, world.state) = (Arc::new(RealClock::start()), Mutex::new(Devices::new(refresh_s)));
        })
    }

    /// The same rig with a camera that runs freely.
    pub fn free_running(self) -> Self {
        self.changed(|world| world.triggering = Triggering::FreeRunning)
    }

    /// The same rig with devices that fail.
    pub fn failing(self, faults: Faults) -> Self {
        self.changed(|world| world.faults = faults)
    }

    /// Time by which frames in real time came later than a camera that need not compute them could have begun the next, s.
    pub fn late_s(&self) -> f64 {
        self.world.state.lock().unwrap_or_else(PoisonError::into_inner).late_s
    }

    /// What every frame delivered so far really was: for tests.
    pub fn truth(&self) -> Vec<Truth> {
        self.world.state.lock().unwrap_or_else(PoisonError::into_inner).truth.clone()
    }
}

impl Bench for TwinBench {
    fn camera(&self) -> &dyn CameraFactory {
        &self.camera
    }

    fn projector(&self) -> &dyn ProjectorFactory {
        &self.projector
    }

    fn clock(&self) -> Arc<dyn Clock> {
        self.world.clock.clone()
    }

    fn place(&mut self, what: Placement) -> Result<(), CaptureError> {
        self.world.scene.lock().unwrap_or_else(PoisonError::into_inner).place(what);
        Ok(())
    }

    fn foresee(&mut self, patterns: &[Pattern]) {
        self.world.scene.lock().unwrap_or_else(PoisonError::into_inner).foresee(patterns);
    }
}
