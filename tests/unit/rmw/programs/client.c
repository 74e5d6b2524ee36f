/* The client library of main.c. */
#define _GNU_SOURCE
#include "fake.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

fake_t *rmw_create_node(void *, const char *, const char *);
int rmw_destroy_node(fake_t *);
fake_t *rmw_create_publisher(void *, const fake_type_t *, const char *, const fake_qos_t *, void *);
fake_t *rmw_create_subscription(void *, const fake_type_t *, const char *, const fake_qos_t *, void *);
fake_t *rmw_create_service(void *, const fake_type_t *, const char *, const fake_qos_t *);
fake_t *rmw_create_client(void *, const fake_type_t *, const char *, const fake_qos_t *);
int rmw_destroy_publisher(void *, fake_t *);
int rmw_destroy_subscription(void *, fake_t *);
int rmw_destroy_service(void *, fake_t *);
int rmw_publish(const fake_t *, const void *, void *);
int rmw_publish_serialized_message(const fake_t *, const fake_bytes_t *, void *);
int rmw_publish_loaned_message(const fake_t *, void *, void *);
int rmw_take(const fake_t *, void *, bool *, void *);
int rmw_take_with_info(const fake_t *, void *, bool *, fake_info_t *, void *);
int rmw_take_loaned_message_with_info(const fake_t *, void **, bool *, fake_info_t *, void *);
int rmw_take_loaned_message(const fake_t *, void **, bool *, void *);
int rmw_take_sequence(const fake_t *, size_t, fake_list_t *, fake_list_t *, size_t *, void *);
int rmw_take_response(const fake_t *, fake_header_t *, void *, bool *);
int rcl_timer_call(void *);
int rmw_take_request(const fake_t *, fake_header_t *, void *, bool *);
int rmw_send_response(const fake_t *, fake_id_t *, void *);
int rmw_send_request(const fake_t *, const void *, int64_t *);
int rmw_service_server_is_available(const fake_t *, const fake_t *, bool *);
int rmw_count_services(const fake_t *, const char *, size_t *);
int rmw_wait(fake_set_t *, fake_set_t *, fake_set_t *, fake_set_t *, fake_set_t *, void *,
             const fake_duration_t *);
int rmw_subscription_set_on_new_message_callback(fake_t *, fake_callback_t, const void *);
int rmw_service_set_on_new_request_callback(fake_t *, fake_callback_t, const void *);
#pragma weak rmw_publish_serialized_message
#pragma weak rmw_publish_loaned_message
#pragma weak rmw_take_with_info
#pragma weak rmw_take_loaned_message_with_info
#pragma weak rmw_take_loaned_message
#pragma weak rmw_take_sequence
#pragma weak rmw_subscription_set_on_new_message_callback
#pragma weak rmw_service_set_on_new_request_callback

static const char *const names[] = {"std_msgs::msg", "UInt64"};
static const fake_type_t *find_type(const fake_type_t *type, const char *dialect) {
  return strstr(dialect, "fastrtps") ? type : NULL;
}
static const fake_type_t type = {"rosidl_typesupport_c", names, find_type};

static struct named { char kind; char name[128]; fake_t *entity; _Atomic size_t told; } all[8192];
static int count;
static fake_t *node;

static struct named *find(char kind, const char *name) {
  for (int i = 0; i < count; i++)
    if (all[i].kind == kind && !strcmp(all[i].name, name)) return &all[i];
  fprintf(stderr, "%c %s does not exist\n", kind, name);
  exit(2);
}

static void create(char kind, const char *name, int durability, int depth) {
  fake_qos_t qos = {1, (size_t)depth, 1, durability};
  fake_t *made = kind == 'p'   ? rmw_create_publisher(node, &type, name, &qos, NULL)
                 : kind == 's' ? rmw_create_subscription(node, &type, name, &qos, NULL)
                 : kind == 'v' ? rmw_create_service(node, &type, name, &qos)
                               : rmw_create_client(node, &type, name, &qos);
  all[count].kind = kind;
  snprintf(all[count].name, sizeof all[count].name, "%s", name);
  all[count++].entity = made;
}

static void on_arrival(const void *to, size_t number) {
  atomic_fetch_add(&((struct named *)to)->told, number);
}

static void set_writer(uint8_t *writer, int which) {
  pid_t pid = getpid();
  memset(writer, 0, 16);
  memcpy(writer, which < 0 ? &pid : &(int){which}, 4);
  writer[15] = 1;
}

static void set_uuid(uint8_t *uuid, const char *text) {
  memset(uuid, 0, 16);
  for (int i = 0; i < 16 && text[2 * i]; i++) {
    unsigned byte = 0;
    sscanf(text + 2 * i, "%2x", &byte);
    uuid[i] = (uint8_t)byte;
  }
}

static void print_taken(int answer, bool taken, uint64_t number) {
  if (answer) printf("error %d\n", answer);
  else if (taken) printf("%llu\n", (unsigned long long)number);
  else puts("-");
}

static void take(const char *name, const char *how) {
  fake_t *from = find('s', name)->entity;
  fake_message_t message = {0}, *lent = NULL;
  fake_info_t info;
  bool taken = false;
  size_t several = 0;
  int answer;
  if (!strcmp(how, "plain")) answer = rmw_take(from, &message, &taken, NULL);
  else if (!strcmp(how, "info")) answer = rmw_take_with_info(from, &message, &taken, &info, NULL);
  else if (!strcmp(how, "sequence") || !strcmp(how, "humble")) {
    fake_message_t room[8] = {0};
    void *places[8];
    char spaces[8 * 72];
    fake_list_t messages = {places, 0, 8}, infos = {spaces, 0, 8};
    for (int i = 0; i < 8; i++) places[i] = &room[i];
    answer = rmw_take_sequence(from, 8, &messages, &infos, &several, NULL);
    if (answer || !several) return print_taken(answer, false, 0);
    size_t size = sizeof info + (strcmp(how, "humble") ? 0 : 8);
    for (size_t i = 0; i < several; i++) {
      const fake_info_t *one = (const fake_info_t *)(spaces + i * size);
      bool same = one->publication == ((fake_message_t *)places[i])->number;
      printf("%s%llu%s", i ? " " : "", (unsigned long long)((fake_message_t *)places[i])->number, same ? "" : "!");
    }
    puts(messages.size == several && infos.size == several ? "" : " size");
    return;
  } else {
    answer = rmw_take_loaned_message(from, (void **)&lent, &taken, NULL);
    if (taken) message = *lent;
    free(taken ? lent : NULL);
  }
  print_taken(answer, taken, message.number);
}

static void publish(const char *name, uint64_t number, const char *how) {
  fake_t *by = find('p', name)->entity;
  fake_message_t message = {{0}, number}, *lent = malloc(sizeof *lent);
  fake_bytes_t bytes = {(uint8_t *)&message, sizeof message, sizeof message, {0}};
  *lent = message;
  if (!strcmp(how, "loaned")) {
    printf("%d\n", rmw_publish_loaned_message(by, lent, NULL));
    return;
  }
  free(lent);
  printf("%d\n", !strcmp(how, "plain") ? rmw_publish(by, &message, NULL)
                                       : rmw_publish_serialized_message(by, &bytes, NULL));
}

/* A status of one goal, as a message of C or of C++. */
static void publish_status(const char *name, const char *uuid, int status, const char *language) {
  struct { uint8_t uuid[16]; int32_t seconds; uint32_t nanoseconds; int8_t status; } one = {0};
  struct { void *data; uintptr_t second, third; } list = {&one, 1, 1};
  set_uuid(one.uuid, uuid);
  one.status = (int8_t)status;
  if (!strcmp(language, "cpp")) list.second = list.third = (uintptr_t)(&one + 1);
  printf("%d\n", rmw_publish(find('p', name)->entity, &list, NULL));
}

static void wait_for(int milliseconds, int times) {
  void *entities[2][8192];
  for (int time = 0; time < times; time++) {
    fake_set_t sets[2] = {{0, entities[0]}, {0, entities[1]}};
    fake_duration_t limit = {(uint64_t)milliseconds / 1000, (uint64_t)milliseconds % 1000 * 1000000};
    int of[2][8192];
    for (int i = 0; i < count; i++)
      if (all[i].entity && (all[i].kind == 's' || all[i].kind == 'v')) {
        fake_set_t *set = &sets[all[i].kind == 'v'];
        of[all[i].kind == 'v'][set->count] = i;
        set->entities[set->count++] = all[i].entity->data;
      }
    int answer = rmw_wait(&sets[0], NULL, &sets[1], NULL, NULL, &sets, &limit);
    if (time + 1 < times) continue;
    printf("%s", answer == 2 ? "timeout" : answer ? "error" : "ready");
    for (int set = 0; set < 2; set++)
      for (size_t i = 0; i < sets[set].count; i++)
        if (sets[set].entities[i]) printf(" %s", all[of[set][i]].name);
    puts("");
  }
}

/* Everything at once, from several threads. */
static _Atomic bool over;
static void *stress_thread(void *which) {
  char name[64];
  for (uint64_t i = 1; !atomic_load(&over); i++) {
    fake_message_t message = {{0}, i};
    fake_header_t header = {{(int64_t)i, 0}, {{0}, (int64_t)i}};
    bool taken;
    set_writer(header.id.writer, (int)(i % 7) + 1);
    rmw_publish(find('p', "/out")->entity, &message, NULL);
    rmw_publish(find('p', "/map")->entity, &message, NULL);
    fake_arrive(find('s', "/in")->entity, &header, &message);
    rmw_take(find('s', "/in")->entity, &message, &taken, NULL);
    fake_arrive(find('v', "/fib/_action/send_goal")->entity, &header, &message);
    if (!rmw_take_request(find('v', "/fib/_action/send_goal")->entity, &header, &message, &taken) &&
        taken)
      rmw_send_response(find('v', "/fib/_action/send_goal")->entity, &header.id, "\1");
    snprintf(name, sizeof name, "/t%d", (int)(i % 50));
    fake_qos_t qos = {1, 3, 1, 1};
    fake_t *own = rmw_create_publisher(node, &type, name, &qos, NULL);
    rmw_publish(own, &message, NULL);
    rmw_destroy_publisher(node, own);
    void *data = find('s', "/in")->entity->data;
    fake_set_t set = {1, &data};
    rmw_wait(&set, NULL, NULL, NULL, NULL, which, &(fake_duration_t){0, 100000});
  }
  return NULL;
}

static void stress(int milliseconds) {
  pthread_t threads[4];
  create('p', "/out", 0, 10), create('p', "/map", 1, 2), create('s', "/in", 0, 10);
  create('v', "/fib/_action/send_goal", 0, 10);
  for (long i = 0; i < 4; i++) pthread_create(&threads[i], NULL, stress_thread, &all[i]);
  for (int i = 0; i < milliseconds; i++) nanosleep(&(struct timespec){0, 1000000}, NULL);
  atomic_store(&over, true);
  for (int i = 0; i < 4; i++) pthread_join(threads[i], NULL);
  puts("done");
}

static uint64_t now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (uint64_t)t.tv_sec * 1000000000ull + (uint64_t)t.tv_nsec;
}

/* The time of a publication and of a taking, in ns. */
static void measure(int times) {
  create('p', "/out", 0, 10), create('s', "/in", 0, 10);
  fake_t *by = find('p', "/out")->entity, *from = find('s', "/in")->entity;
  fake_message_t message = {{0}, 1};
  bool taken;
  uint64_t taking = 0, begun = now();
  for (int i = 0; i < times; i++) rmw_publish(by, &message, NULL);
  uint64_t publishing = now() - begun;
  for (int i = 0; i < times; i += 1000) {
    fake_header_t header = {{i + 1, 0}, {{0}, i + 1}};
    for (int j = 0; j < 1000; j++) header.id.number++, fake_arrive(from, &header, &message);
    begun = now();
    for (int j = 0; j < 1000; j++) rmw_take(from, &message, &taken, NULL);
    taking += now() - begun;
  }
  printf("%.1f %.1f\n", (double)publishing / times, (double)taking / times);
}

/* A turn of an executor whose threads share a wait set. */
static void turn(uint64_t seconds) {
  rmw_wait(NULL, NULL, NULL, NULL, NULL, &over, &(fake_duration_t){seconds, 1000000});
}

static void *wait_long(void *unused) {
  turn(1000);
  return unused;
}

static void *wait_and_end(void *unused) {
  turn(0);
  return unused;
}

int client_main(void) {
  static char line[4096], verb[32], a[256], b[256], c[256], d[256];
  setvbuf(stdout, NULL, _IOLBF, 0);
  while (fgets(line, sizeof line, stdin)) {
    *a = *b = *c = *d = 0;
    if (sscanf(line, "%31s %255s %255s %255s %255s", verb, a, b, c, d) < 1) continue;
    if (!strcmp(verb, "node")) node = rmw_create_node(NULL, a, *b ? b : "/"), puts("ok");
    else if (!strcmp(verb, "create")) create(*a, b, atoi(c), *d ? atoi(d) : 10), puts("ok");
    else if (!strcmp(verb, "many")) {
      for (int i = 0; i < atoi(a); i++) snprintf(c, sizeof c, "/many%d", i), create('p', c, 0, 1);
      puts("ok");
    } else if (!strcmp(verb, "destroy")) {
      struct named *one = find(*a, b);
      (*a == 'p' ? rmw_destroy_publisher : *a == 's' ? rmw_destroy_subscription : rmw_destroy_service)(node, one->entity);
      *one = all[--count];
      puts("ok");
    } else if (!strcmp(verb, "publish")) publish(a, strtoull(b, NULL, 10), *c ? c : "plain");
    else if (!strcmp(verb, "status")) publish_status(a, b, atoi(c), d);
    else if (!strcmp(verb, "take")) take(a, *b ? b : "plain");
    else if (!strcmp(verb, "arrive") || !strcmp(verb, "ask")) {
      fake_message_t message = {{0}, strtoull(c, NULL, 10)};
      fake_header_t header = {{(int64_t)message.number, 0}, {{0}, (int64_t)message.number}};
      set_writer(header.id.writer, strcmp(b, "own") ? atoi(b) : -1);
      if (!strcmp(d, "uncounted")) header.id.number = -1;
      else if (*d) set_uuid(message.uuid, d);
      fake_arrive(find(*verb == 'k' || verb[1] == 's' ? 'v' : 's', a)->entity, &header, &message);
      puts("ok");
    } else if (!strcmp(verb, "serve")) {
      fake_header_t header;
      fake_message_t request = {0};
      bool taken = false;
      int answer = rmw_take_request(find('v', a)->entity, &header, &request, &taken);
      print_taken(answer, taken, request.number);
    } else if (!strcmp(verb, "answer")) {
      fake_id_t id = {{0}, atoi(c)};
      set_writer(id.writer, atoi(b));
      printf("%d\n", rmw_send_response(find('v', a)->entity, &id, *d == '1' ? "\1" : "\0"));
    } else if (!strcmp(verb, "sent")) {
      uint64_t numbers[256];
      size_t sent = fake_sent(find(*a, b)->entity, numbers, 256);
      for (size_t i = 0; i < sent; i++) printf("%s%llu", i ? " " : "", (unsigned long long)numbers[i]);
      puts("");
    } else if (!strcmp(verb, "match")) fake_match(find(*a, b)->entity, (size_t)atoi(c)), puts("ok");
    else if (!strcmp(verb, "wait")) wait_for(atoi(a), *b ? atoi(b) : 1);
    else if (!strcmp(verb, "listen")) {
      struct named *one = find(*a, b);
      printf("%d\n", (*a == 's' ? rmw_subscription_set_on_new_message_callback : rmw_service_set_on_new_request_callback)(one->entity, on_arrival, one));
    } else if (!strcmp(verb, "told")) printf("%zu\n", atomic_load(&find(*a, b)->told));
    else if (!strcmp(verb, "stress")) stress(atoi(a));
    else if (!strcmp(verb, "timer")) printf("%d\n", rcl_timer_call(NULL));
    else if (!strcmp(verb, "served")) fake_serve(a, atoi(b)), puts("ok");
    else if (!strcmp(verb, "nodes")) fake_nodes((size_t)atoi(a), (size_t)atoi(*b ? b : a)), puts("ok");
    else if (!strcmp(verb, "available")) {
      bool available = false;
      size_t number = 0;
      int answer = rmw_service_server_is_available(node, find('c', a)->entity, &available);
      answer |= rmw_count_services(node, a, &number);
      printf("%s\n", answer || available != !!number ? "error" : available ? "yes" : "no");
    } else if (!strcmp(verb, "request")) {
      fake_message_t request = {{0}, strtoull(b, NULL, 10)};
      int64_t number;
      printf("%d\n", rmw_send_request(find('c', a)->entity, &request, &number));
    } else if (!strcmp(verb, "response")) {
      fake_message_t message = {{0}, strtoull(b, NULL, 10)};
      fake_header_t header = {{0, 0}, {{0}, (int64_t)message.number}};
      bool taken = false;
      fake_arrive(find('c', a)->entity, &header, &message);
      int answer = rmw_take_response(find('c', a)->entity, &header, &message, &taken);
      print_taken(answer, taken, message.number);
    } else if (!strcmp(verb, "measure")) measure(atoi(a));
    else if (!strcmp(verb, "turn")) turn(0), rcl_timer_call(NULL), puts("ok");
    else if (!strcmp(verb, "beside")) {
      pthread_t thread;
      pthread_create(&thread, NULL, wait_long, NULL);
      puts("ok");
    } else if (!strcmp(verb, "thread")) {
      pthread_t thread;
      pthread_create(&thread, NULL, wait_and_end, NULL);
      pthread_join(thread, NULL);
      puts("ok");
    } else if (!strcmp(verb, "fork")) {
      fflush(stdout);
      pid_t child = fork();
      if (!child) continue; /* it answers the commands from now on, and its parent waits */
      int status;
      waitpid(child, &status, 0);
      _exit(status ? 9 : 0);
    } else if (!strcmp(verb, "exec")) execl("/bin/cat", "cat", NULL);
    else if (!strcmp(verb, "_exit")) _exit(0);
    else if (!strcmp(verb, "abort")) abort();
    else if (!strcmp(verb, "pid")) printf("%d\n", getpid());
    else return fprintf(stderr, "unknown: %s", line), 2;
  }
  return 0;
}
