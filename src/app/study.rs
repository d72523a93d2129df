//! A session on a thread of its own: products arrive one after the other, most wanted first.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::flight::{Coverage, Flight};
use crate::session::{
    CancelToken, Centered, Fields, Levels, Progress, Segmented, Session, SessionError, Wall,
};
use crate::volume::Volume;

/// A product that is there now, or the end.
pub enum News {
    /// The volume the slices show.
    Volume(Arc<Volume>),
    /// BLAKE3 of the volume's samples.
    Identity(String),
    /// The lumen.
    Lumen(Arc<Segmented>),
    /// The wall: from here on there is a picture.
    Wall(Arc<Wall>),
    /// Distances: from here on the eye can be moved by hand.
    Fields(Arc<Fields>),
    /// The path.
    Centerline(Arc<Centered>),
    /// The flight along it.
    Flight(Arc<Flight>),
    /// Levels of detail.
    Levels(Arc<Levels>),
    /// What the flight sees.
    Coverage(Arc<Coverage>),
    /// Nothing more comes, because of this.
    Failed(SessionError),
    /// Everything came.
    Complete,
}

/// A session at work.
pub struct Study {
    session: Arc<Session>,
    news: Receiver<News>,
    cancel: CancelToken,
    thread: Option<JoinHandle<()>>,
}

impl Study {
    /// Starts a session's products.
    ///
    /// * `wake`: called on the study's thread after each piece of news.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn begin(
        mut session: Session,
        wake: impl Fn() + Send + 'static,
    ) -> Result<Self, SessionError> {
        session.keep_volume();
        let session = Arc::new(session);
        let (sender, news) = channel();
        let theirs = Arc::clone(&session);
        let work = move || {
            let last = match each_product(&theirs, &|n| {
                let sent = sender.send(n).is_ok();
                wake();
                sent
            }) {
                Ok(()) => News::Complete,
                Err(e) => News::Failed(e),
            };
            let _ = sender.send(last);
            wake();
        };
        let thread = std::thread::Builder::new()
            .name("study".into())
            .spawn(work)
            .map_err(|e| SessionError::System(e.to_string()))?;
        let cancel = session.cancel_token();
        Ok(Self { session, news, cancel, thread: Some(thread) })
    }

    /// The next piece of news, if there is one. Never waits.
    pub fn poll(&self) -> Option<News> {
        self.news.try_recv().ok()
    }

    /// Waits for the next piece of news; `None` after the last, or when the time is over.
    pub fn wait(&self, most: Duration) -> Option<News> {
        self.news.recv_timeout(most).ok()
    }

    /// How far it has come.
    pub fn progress(&self) -> Progress {
        self.session.progress()
    }

    /// Stops it; what is there stays.
    pub fn cancel(&self) {
        self.cancel.cancel();
    }
}

impl Drop for Study {
    fn drop(&mut self) {
        self.cancel();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Asks for product after product; `tell` answers whether anybody still listens.
fn each_product(session: &Session, tell: &dyn Fn(News) -> bool) -> Result<(), SessionError> {
    let volume = session.volume()?;
    let identity = || blake3::hash(volume.samples.bytes()).to_hex().to_string();
    let listens = tell(News::Volume(Arc::clone(&volume)))
        && tell(News::Lumen(session.lumen()?))
        && tell(News::Wall(session.wall()?))
        && tell(News::Identity(identity()))
        && tell(News::Fields(session.fields()?))
        && tell(News::Centerline(session.centerline()?))
        && tell(News::Flight(session.flight()?))
        && tell(News::Levels(session.levels()?))
        && tell(News::Coverage(session.coverage()?));
    if listens { Ok(()) } else { Err(SessionError::Cancelled) }
}
