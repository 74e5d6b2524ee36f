/* A middleware in memory, with queues: what ROS 2's client libraries call, as far as the layer
 * stands before it. Built with MINIMAL it lacks what is optional; with CYCLONE it names who sends
 * as Cyclone DDS does, by handles that are different in each process; with ZENOH the identifiers of
 * a process' entities have nothing in common. */
#define _GNU_SOURCE
#include "fake.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { DEPTH = 4096 };
struct arrived { fake_header_t header; fake_message_t message; };
struct queue {
  int32_t number, *subscription; /* as Cyclone DDS has them; the latter of a service */
  int32_t its_number;
  struct arrived arrived[DEPTH];
  size_t first, count;
  uint64_t sent[DEPTH];
  size_t sent_count, partners;
  fake_callback_t callback;
  const void *to;
};
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
#ifdef CYCLONE
static const char identifier[] = "rmw_cyclonedds_cpp";
#elif defined ZENOH
static const char identifier[] = "rmw_zenoh_cpp";
#else
static const char identifier[] = "rmw_fake";
#endif

static fake_t *make(const char *name, bool is_service) {
  static _Atomic int32_t last;
  fake_t *made = calloc(1, sizeof *made);
  struct queue *queue = calloc(1, sizeof *queue);
  made->identifier = identifier;
  made->name = strdup(name);
  made->data = queue;
  queue->its_number = ++last;
  queue->subscription = &queue->its_number;
  queue->number = is_service ? -1 : queue->its_number;
  return made;
}

static int destroy(fake_t *entity) {
  free((void *)entity->name);
  free(entity->data);
  free(entity);
  return 0;
}

void fake_arrive(fake_t *entity, const fake_header_t *header, const fake_message_t *message) {
  struct queue *queue = entity->data;
  pthread_mutex_lock(&mutex);
  if (queue->count < DEPTH)
    queue->arrived[(queue->first + queue->count++) % DEPTH] = (struct arrived){*header, *message};
  fake_callback_t callback = queue->callback;
  const void *to = queue->to;
  pthread_mutex_unlock(&mutex);
  if (callback) callback(to, 1);
}

size_t fake_sent(fake_t *entity, uint64_t *into, size_t most) {
  struct queue *queue = entity->data;
  pthread_mutex_lock(&mutex);
  size_t count = queue->sent_count < most ? queue->sent_count : most;
  memcpy(into, queue->sent, count * sizeof *into);
  pthread_mutex_unlock(&mutex);
  return count;
}

void fake_match(fake_t *entity, size_t partners) { ((struct queue *)entity->data)->partners = partners; }

#ifdef CYCLONE
/* The GUIDs of who sends; their places, with this process' number, are the handles. */
static uint8_t guids[2048][16];
static uint64_t guid_count;

static uint64_t handle_of(const uint8_t *guid) {
  uint64_t at = 0;
  pthread_mutex_lock(&mutex);
  while (at < guid_count && memcmp(guids[at], guid, 16)) at++;
  if (at == guid_count) memcpy(guids[guid_count++], guid, 16);
  pthread_mutex_unlock(&mutex);
  return (uint64_t)getpid() << 32 | at;
}
uint8_t *dds_get_matched_publication_data(int32_t reader, uint64_t handle) {
  uint8_t guid[16];
  pthread_mutex_lock(&mutex);
  memcpy(guid, guids[handle & 2047], 16);
  pthread_mutex_unlock(&mutex);
  bool known = reader > 0 && handle >> 32 == (uint64_t)getpid() && *guid != GONE;
  return known ? memcpy(malloc(16), guid, 16) : NULL;
}
void dds_builtintopic_free_endpoint(uint8_t *found) { free(found); }
/* Identifiers of a process begin with its number. */
int dds_get_guid(int32_t entity, uint8_t *guid) {
  pid_t pid = getpid();
  memset(guid, 0, 16);
  memcpy(guid, &pid, sizeof pid);
  memcpy(guid + 12, &entity, sizeof entity);
  return 0;
}
#endif

static int send_number(const fake_t *entity, uint64_t number) {
  struct queue *queue = entity->data;
  pthread_mutex_lock(&mutex);
  if (queue->sent_count < DEPTH) queue->sent[queue->sent_count++] = number;
  pthread_mutex_unlock(&mutex);
  return 0;
}

static bool take_one(const fake_t *entity, struct arrived *into) {
  struct queue *queue = entity->data;
  pthread_mutex_lock(&mutex);
  bool any = queue->count > 0;
  if (any) {
    *into = queue->arrived[queue->first];
    queue->first = (queue->first + 1) % DEPTH;
    queue->count--;
  }
  pthread_mutex_unlock(&mutex);
  return any;
}

fake_t *rmw_create_node(void *context, const char *name, const char *ns) {
  fake_t *made = make(name, false);
  made->context = context;
  made->ns = ns;
  return made;
}
int rmw_destroy_node(fake_t *node) { return destroy(node); }

#define CREATE(what, ...)                                                                  \
  fake_t *rmw_create_##what(void *node, const fake_type_t *type, const char *name,         \
                            const fake_qos_t *qos, ##__VA_ARGS__) {                        \
    (void)node, (void)type, (void)qos;                                                     \
    return make(name, !strcmp(#what, "service"));                                          \
  }                                                                                        \
  int rmw_destroy_##what(void *node, fake_t *entity) {                                     \
    (void)node;                                                                            \
    return destroy(entity);                                                                \
  }
CREATE(publisher, void *options)
CREATE(subscription, void *options)
CREATE(service)
CREATE(client)

int rmw_publish(const fake_t *publisher, const fake_message_t *message, void *allocation) {
  (void)allocation;
  return message ? send_number(publisher, message->number) : 11;
}
int rmw_take(const fake_t *subscription, fake_message_t *message, bool *taken, void *allocation) {
  struct arrived one;
  (void)allocation;
  if ((*taken = take_one(subscription, &one))) *message = one.message;
  return 0;
}
static int take_with_header(const fake_t *from, fake_header_t *header, fake_message_t *into,
                            bool *taken) {
  struct arrived one;
  if ((*taken = take_one(from, &one))) *header = one.header, *into = one.message;
  return 0;
}
int rmw_take_request(const fake_t *service, fake_header_t *header, fake_message_t *request,
                     bool *taken) {
  int answer = take_with_header(service, header, request, taken);
#ifdef CYCLONE
  uint64_t handle = *taken ? handle_of(header->id.writer) : 0;
  header->id.writer[0] ^= 0xff; /* the client's own number, which is not of its GUID */
  memcpy(header->id.writer + 8, &handle, sizeof handle);
#endif
  return answer;
}
int rmw_send_response(const fake_t *service, fake_id_t *id, void *response) {
  (void)response;
  return send_number(service, (uint64_t)id->number);
}
int rmw_send_request(const fake_t *client, const fake_message_t *request, int64_t *number) {
  *number = (int64_t)request->number;
  return send_number(client, request->number);
}
int rmw_take_response(const fake_t *client, fake_header_t *header, fake_message_t *response,
                      bool *taken) {
  return take_with_header(client, header, response, taken);
}
int rmw_wait(fake_set_t *subscriptions, fake_set_t *conditions, fake_set_t *services,
             fake_set_t *clients, fake_set_t *events, void *set, const fake_duration_t *timeout) {
  fake_set_t *all[] = {subscriptions, services, clients};
  (void)conditions, (void)events, (void)set;
  for (uint64_t waited = 0;; waited += 500000) {
    size_t ready = 0;
    pthread_mutex_lock(&mutex);
    for (int i = 0; i < 3; i++)
      for (size_t j = 0; all[i] && j < all[i]->count; j++)
        ready += ((struct queue *)all[i]->entities[j])->count > 0;
    bool over = timeout && waited >= timeout->seconds * 1000000000ull + timeout->nanoseconds;
    if (ready || over)
      for (int i = 0; i < 3; i++)
        for (size_t j = 0; all[i] && j < all[i]->count; j++)
          if (!((struct queue *)all[i]->entities[j])->count) all[i]->entities[j] = NULL;
    pthread_mutex_unlock(&mutex);
    if (ready || over) return ready ? 0 : 2;
    nanosleep(&(struct timespec){0, 500000}, NULL);
  }
}
/* Servers of services in other processes, as the graph has them: how their identifiers begin. */
static struct { char topic[64]; pid_t pid; } servers[16];
static int server_count;

void fake_serve(const char *service, pid_t pid) {
  snprintf(servers[server_count].topic, sizeof servers->topic, "rq%sRequest", service);
  servers[server_count++].pid = pid;
}
int rmw_service_server_is_available(const fake_t *node, const fake_t *client, bool *available) {
  (void)node, (void)client;
  *available = server_count > 0;
  return 0;
}
int rmw_count_services(const fake_t *node, const char *service, size_t *number) {
  (void)node, (void)service;
  *number = (size_t)server_count;
  return 0;
}
static size_t node_count, name_count;

void fake_nodes(size_t number, size_t names) { node_count = number, name_count = names; }
static char **texts_of(fake_texts_t *into, const char *format) {
  into->count = node_count;
  into->texts = calloc(node_count, sizeof *into->texts);
  for (size_t i = 0; i < node_count; i++) asprintf(&into->texts[i], format, i % name_count);
  return into->texts;
}
static void free_text(void *text, void *state) {
  (void)state;
  free(text);
}
int rmw_get_node_names(const fake_t *node, fake_texts_t *names, fake_texts_t *spaces) {
  (void)node;
  names->allocator.deallocate = spaces->allocator.deallocate = free_text;
  return texts_of(names, "node_%zu") && texts_of(spaces, "/robot") ? 0 : 1;
}
int rcl_timer_call(void *timer) {
  (void)timer;
  return 0;
}
#ifndef MINIMAL
static int take_with_info(const fake_t *subscription, fake_message_t *message, bool *taken,
                          fake_info_t *info) {
  struct arrived one;
  if (!(*taken = take_one(subscription, &one))) return 0;
  *message = one.message;
  memset(info, 0, sizeof *info);
  info->stamps = one.header.stamps;
  info->publication = (uint64_t)one.header.id.number;
#ifdef CYCLONE
  uint64_t handle = handle_of(one.header.id.writer);
  memcpy(info->publisher.data, &handle, sizeof handle);
#else
  memcpy(info->publisher.data, one.header.id.writer, 16);
#endif
  return 0;
}
int rmw_take_with_info(const fake_t *subscription, fake_message_t *message, bool *taken,
                       fake_info_t *info, void *allocation) {
  (void)allocation;
  return take_with_info(subscription, message, taken, info);
}
int rmw_take_loaned_message_with_info(const fake_t *subscription, void **message, bool *taken,
                                      fake_info_t *info, void *allocation) {
  fake_message_t *lent = malloc(sizeof *lent);
  int answer = rmw_take_with_info(subscription, lent, taken, info, allocation);
  if (*taken) *message = lent;
  else free(lent);
  return answer;
}
int rmw_return_loaned_message_from_subscription(const fake_t *subscription, void *message) {
  (void)subscription;
  free(message);
  return 0;
}
/* An info_t of humble is longer: HUMBLE. */
int rmw_take_sequence(const fake_t *subscription, size_t most, fake_list_t *messages,
                      fake_list_t *infos, size_t *taken, void *allocation) {
  bool one;
  (void)allocation;
#ifdef HUMBLE
  const size_t size = sizeof(fake_info_t) + 8;
#else
  const size_t size = sizeof(fake_info_t);
#endif
  for (*taken = 0; *taken < most; ++*taken) {
    fake_info_t *info = (fake_info_t *)((char *)infos->data + *taken * size);
    take_with_info(subscription, ((void **)messages->data)[*taken], &one, info);
    if (!one) break;
  }
  messages->size = infos->size = *taken;
  return 0;
}
#ifndef HUMBLE
int rmw_take_dynamic_message(const fake_t *subscription, void *message, bool *taken,
                             void *allocation) {
  return rmw_take(subscription, message, taken, allocation);
}
#endif
int rmw_publish_loaned_message(const fake_t *publisher, void *message, void *allocation) {
  (void)allocation;
  send_number(publisher, ((fake_message_t *)message)->number);
  free(message);
  return 0;
}
int rmw_return_loaned_message_from_publisher(const fake_t *publisher, void *message) {
  (void)publisher;
  free(message);
  return 0;
}
int rmw_serialize(const fake_message_t *message, const fake_type_t *type, fake_bytes_t *into) {
  (void)type;
  into->buffer = into->allocator.allocate(sizeof *message, into->allocator.state);
  memcpy(into->buffer, message, sizeof *message);
  into->length = into->capacity = sizeof *message;
  return 0;
}
int rmw_publish_serialized_message(const fake_t *publisher, const fake_bytes_t *bytes,
                                   void *allocation) {
  return rmw_publish(publisher, (const fake_message_t *)bytes->buffer, allocation);
}
int rmw_publisher_count_matched_subscriptions(const fake_t *publisher, size_t *number) {
  return *number = ((struct queue *)publisher->data)->partners, 0;
}
int rmw_subscription_count_matched_publishers(const fake_t *subscription, size_t *number) {
  return *number = ((struct queue *)subscription->data)->partners, 0;
}
/* Identifiers of a process begin with its number. */
int rmw_get_gid_for_publisher(const fake_t *publisher, fake_gid_t *gid) {
  pid_t pid = getpid();
  memset(gid, 0, sizeof *gid);
  gid->identifier = identifier;
#if defined CYCLONE || defined ZENOH
  pid = ~pid; /* a handle, or a hash of the publisher alone */
#endif
  memcpy(gid->data, &pid, sizeof pid);
  memcpy(gid->data + 12, &publisher, 4);
  return 0;
}
int rmw_get_gid_for_client(const fake_t *client, fake_gid_t *gid) {
  pid_t pid = getpid();
  memset(gid, 0, sizeof *gid);
  memcpy(gid->data, &pid, sizeof pid);
  memcpy(gid->data + 12, &client, 4);
  return 0;
}
static int set_callback(fake_t *entity, fake_callback_t callback, const void *to) {
  struct queue *queue = entity->data;
  pthread_mutex_lock(&mutex);
  queue->callback = callback;
  queue->to = to;
  pthread_mutex_unlock(&mutex);
  return 0;
}
int rmw_get_subscriptions_info_by_topic(const fake_t *node, fake_allocator_t *allocator,
                                        const char *topic, bool as_is, fake_ends_t *found) {
  (void)node;
  found->ends = allocator->zero_allocate(16, sizeof *found->ends, allocator->state);
  for (int i = 0; as_is && i < server_count; i++)
    if (!strcmp(servers[i].topic, topic))
      memcpy(found->ends[found->count++].gid, &servers[i].pid, sizeof(pid_t));
  return 0;
}
int rmw_topic_endpoint_info_array_fini(fake_ends_t *found, fake_allocator_t *allocator) {
  allocator->deallocate(found->ends, allocator->state);
  return 0;
}
int rmw_subscription_set_on_new_message_callback(fake_t *entity, fake_callback_t callback,
                                                 const void *to) {
  return set_callback(entity, callback, to);
}
int rmw_service_set_on_new_request_callback(fake_t *entity, fake_callback_t callback,
                                            const void *to) {
  return set_callback(entity, callback, to);
}
#endif
