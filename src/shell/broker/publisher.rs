//! A connection that publishes: sends what a [`Publication`] has, and tells it what became of it.

use super::address::BrokerSettings;
use super::back_off;
use super::failure::BrokerFailure;
use crate::fleet::{FleetMessage, FleetMessageId, MessageLength, OtherRun, Publication};
use crate::shell::waiting::block_on;
use crate::time::Duration;
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use rumqttc::{
    AsyncClient, Event, EventLoop, LastWill, Outgoing, Packet, PubAckReason, PublishNotice,
    PublishNoticeError, PublishOptions, QoS, RetainForwardRule, SubscribeFilterInput,
};
use std::cell::Cell;
use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use tokio::sync::Notify;
use tokio::time::sleep;

/// Number of notices that wait at most; further ones are dropped.
const MAX_NOTICES: usize = 64;

/// Bytes of a packet besides topic and content, at most.
const PACKET_HEAD: usize = 16;

/// Time in which the documents of an earlier run arrive.
const READING: Duration = Duration::from_secs(10);

/// Wait where the queue of the connection is full.
const FULL_QUEUE_NAP: Duration = Duration::from_millis(50);

/// Longest wait for the end of the connection.
const FAREWELL: Duration = Duration::from_millis(300);

/// What happened to the connection.
#[derive(Clone, Debug)]
pub enum PublisherNotice {
    /// The broker is connected.
    Connected,
    /// The connection failed, and is tried again after this time; `None` if it is not.
    Failed(BrokerFailure, Option<Duration>),
    /// The broker refused a message with this topic, and why.
    Refused(String, &'static str),
}

/// What the two threads share.
struct Shared {
    publication: Mutex<Publication>,
    /// The publication has something to send.
    changed: Notify,
    /// Everything may be delivered.
    delivered: Condvar,
    stop: Notify,
}

impl Shared {
    fn publication(&self) -> MutexGuard<'_, Publication> {
        self.publication.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// See the module's documentation.
pub struct BrokerPublisher {
    shared: Arc<Shared>,
    notices: Receiver<PublisherNotice>,
    /// What happened while the end was waited for.
    last_notices: VecDeque<PublisherNotice>,
}

impl BrokerPublisher {
    /// Connects, on a thread of its own, and connects again when the connection is lost.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(settings: &BrokerSettings, publication: Publication) -> io::Result<Self> {
        let mut options = settings.options(&format!("descan-{}", publication.gateway()));
        options.set_last_will(as_last_will(publication.last_will()));
        let own = publication.gateway().filter();
        let shared = Arc::new(Shared {
            publication: Mutex::new(publication),
            changed: Notify::new(),
            delivered: Condvar::new(),
            stop: Notify::new(),
        });
        let (sender, notices) = mpsc::sync_channel(MAX_NOTICES);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let task = PublisherThread {
            shared: Arc::clone(&shared),
            notices: sender,
            settings: settings.clone(),
            own,
            reading: Notify::new(),
            has_progress: Cell::new(false),
        };
        thread::Builder::new().name("broker".to_owned()).spawn(move || {
            // More than are sent at once: a request never waits for room.
            let (client, events) = AsyncClient::builder(options).capacity(256).build();
            block_on(&runtime, task.run(&client, events));
        })?;
        Ok(Self { shared, notices, last_notices: VecDeque::new() })
    }

    /// Changes the publication, and sends what it has then.
    pub fn update<T>(&self, change: impl FnOnce(&mut Publication) -> T) -> T {
        let result = change(&mut self.shared.publication());
        self.shared.changed.notify_one();
        result
    }

    /// Returns what happened since.
    pub fn poll_notice(&mut self) -> Option<PublisherNotice> {
        self.last_notices.pop_front().or_else(|| self.notices.try_recv().ok())
    }

    /// Waits until everything is delivered, at most for `time`, and disconnects for good.
    ///
    /// # Errors
    /// What the broker does not have.
    pub fn finish(&mut self, time: Duration) -> Result<(), &'static str> {
        let publication = self.shared.publication();
        let waits = |publication: &mut Publication| !publication.is_delivered();
        let waited = self.shared.delivered.wait_timeout_while(publication, time, waits);
        let is_delivered = waited.is_ok_and(|(_, result)| !result.timed_out());
        let is_incomplete = self.shared.publication().is_incomplete();
        self.shared.stop.notify_one();
        // The thread closes its end when it has disconnected.
        while let Ok(notice) = self.notices.recv_timeout(FAREWELL) {
            self.last_notices.push_back(notice);
        }
        match (is_delivered, is_incomplete) {
            (true, false) => Ok(()),
            (true, true) => Err("the broker does not have all documents and events"),
            (false, _) => Err("the broker does not have the last documents and events"),
        }
    }
}

/// The thread of the connection.
struct PublisherThread {
    shared: Arc<Shared>,
    notices: SyncSender<PublisherNotice>,
    settings: BrokerSettings,
    /// Topic filter of what this gateway publishes.
    own: String,
    /// The subscription to all documents began.
    reading: Notify,
    /// The broker acknowledged something since the last failure.
    has_progress: Cell<bool>,
}

impl PublisherThread {
    async fn run(self, client: &AsyncClient, mut events: EventLoop) {
        tokio::select! {
            () = self.receive(client, &mut events) => return,
            () = self.send(client) => return,
            () = self.stop_reading(client) => return,
            () = self.shared.stop.notified() => {}
        }
        // Without a DISCONNECT the broker would publish the last will.
        let _ = client.try_disconnect();
        let farewell = async {
            while let Ok(event) = events.poll().await {
                if matches!(event, Event::Outgoing(Outgoing::Disconnect)) {
                    break;
                }
            }
        };
        let _ = tokio::time::timeout(FAREWELL, farewell).await;
    }

    /// Drives the connection until it fails for good.
    async fn receive(&self, client: &AsyncClient, events: &mut EventLoop) {
        let mut failures = 0;
        let mut was_connected = false;
        loop {
            match events.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(packet))) => {
                    was_connected = true;
                    // The session of an earlier run is not this one's: only later ones are kept.
                    events.options.set_clean_start(false);
                    {
                        let mut publication = self.shared.publication();
                        let properties = packet.properties.as_ref();
                        let max_packet = properties.and_then(|it| it.max_packet_size);
                        let max_packet = max_packet.map_or(usize::MAX, |it| it as usize);
                        publication.set_max_message(max_packet.saturating_sub(PACKET_HEAD));
                        publication.handle_connected(packet.session_present);
                    }
                    self.shared.changed.notify_one();
                    // Its status first: before it is sent again.
                    Self::subscribe(client, &self.own.replace('#', "status"));
                    self.read_documents(client);
                    // A kept session may have it from an earlier connection.
                    self.reading.notify_one();
                    self.report(PublisherNotice::Connected);
                }
                Ok(Event::Incoming(Packet::Publish(message))) => {
                    let topic = String::from_utf8_lossy(&message.topic);
                    let other = self.shared.publication().handle_message(
                        &topic,
                        &message.payload,
                        message.retain,
                    );
                    self.shared.changed.notify_one();
                    self.read_documents(client);
                    if other == OtherRun::Later {
                        let failure = BrokerFailure::replaced(&self.settings.address);
                        self.report(PublisherNotice::Failed(failure, None));
                        return;
                    }
                }
                Ok(_) => {}
                Err(error) => {
                    let last_will = {
                        let mut publication = self.shared.publication();
                        publication.handle_disconnected();
                        publication.last_will()
                    };
                    events.options.set_last_will(as_last_will(last_will));
                    let failure = BrokerFailure::of(&self.settings.address, &error, was_connected);
                    if self.has_progress.replace(false) {
                        failures = 0;
                    }
                    failures += 1;
                    if failure.is_final && !was_connected {
                        self.report(PublisherNotice::Failed(failure, None));
                        return;
                    }
                    let wait = back_off(failures);
                    self.report(PublisherNotice::Failed(failure, Some(wait)));
                    sleep(wait).await;
                }
            }
        }
    }

    /// Reads what the broker has for a topic filter, and what is published later.
    fn subscribe(client: &AsyncClient, filter: &str) {
        let filter = SubscribeFilterInput::new(filter, QoS::AtLeastOnce)
            .retain_forward_rule(RetainForwardRule::OnEverySubscribe);
        let _ = client.try_subscribe_many([filter]);
    }

    /// Reads all documents of this gateway, for a while, if they are to be read.
    fn read_documents(&self, client: &AsyncClient) {
        if self.shared.publication().poll_reading() {
            Self::subscribe(client, &self.own);
            self.reading.notify_one();
        }
    }

    /// Ends the subscription to all documents, a while after it began.
    async fn stop_reading(&self, client: &AsyncClient) {
        loop {
            self.reading.notified().await;
            sleep(READING).await;
            let _ = client.try_unsubscribe(self.own.as_str());
        }
    }

    /// Sends what the publication has.
    async fn send(&self, client: &AsyncClient) {
        let mut sent = FuturesUnordered::new();
        loop {
            while let Some(message) = self.next_message() {
                let FleetMessage { topic, payload, is_retained, length, id } = message;
                let why = "it takes no packet of this length";
                match length {
                    MessageLength::Accepted => {}
                    // The connection would end with it.
                    MessageLength::TooLong => {
                        self.handle_fate(topic, &id, Fate::Refused(why));
                        continue;
                    }
                    MessageLength::Cleared => {
                        if self.shared.publication().refused() == 1 {
                            self.report(PublisherNotice::Refused(topic.clone(), why));
                        }
                    }
                }
                let options = PublishOptions::new(QoS::AtLeastOnce).retain(is_retained);
                let sending = client.try_publish_tracked(topic.clone(), payload.to_vec(), options);
                let Ok(notice) = sending else {
                    // No room: the connection has to go on first.
                    self.shared.publication().handle_undelivered(&id);
                    sleep(FULL_QUEUE_NAP).await;
                    break;
                };
                sent.push(fate(topic, id, notice));
            }
            tokio::select! {
                () = self.shared.changed.notified() => {}
                Some((topic, id, fate)) = sent.next(), if !sent.is_empty() => {
                    self.handle_fate(topic, &id, fate);
                }
            }
        }
    }

    fn next_message(&self) -> Option<FleetMessage> {
        self.shared.publication().poll_message()
    }

    fn handle_fate(&self, topic: String, id: &FleetMessageId, fate: Fate) {
        let mut publication = self.shared.publication();
        match fate {
            Fate::Delivered => {
                self.has_progress.set(true);
                publication.handle_delivered(id);
            }
            Fate::Lost => publication.handle_undelivered(id),
            Fate::Refused(why) => {
                publication.handle_refused(id);
                if publication.refused() == 1 {
                    self.report(PublisherNotice::Refused(topic, why));
                }
            }
        }
        if publication.is_delivered() {
            self.shared.delivered.notify_all();
        }
    }

    fn report(&self, notice: PublisherNotice) {
        let _ = self.notices.try_send(notice);
    }
}

fn as_last_will(message: FleetMessage) -> LastWill {
    let payload = message.payload.to_vec();
    LastWill::new(message.topic, payload, QoS::AtLeastOnce, message.is_retained, None)
}

/// What became of a message.
#[derive(Clone, Copy)]
enum Fate {
    Delivered,
    Lost,
    Refused(&'static str),
}

async fn fate(
    topic: String,
    id: FleetMessageId,
    notice: PublishNotice,
) -> (String, FleetMessageId, Fate) {
    let fate = match notice.wait_completion_async().await {
        Ok(()) => Fate::Delivered,
        Err(PublishNoticeError::RetainNotSupported) => Fate::Refused("it keeps no messages"),
        Err(PublishNoticeError::V5PubAck(PubAckReason::NotAuthorized)) => {
            Fate::Refused("the user has no right to write it")
        }
        Err(PublishNoticeError::V5PubAck(PubAckReason::QuotaExceeded)) => {
            Fate::Refused("it has too many messages")
        }
        Err(PublishNoticeError::V5PubAck(_)) => Fate::Refused("without a reason"),
        Err(_) => Fate::Lost,
    };
    (topic, id, fate)
}
